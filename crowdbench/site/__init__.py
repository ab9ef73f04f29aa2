"""The page that a browser opens: leaderboards, replays, agents."""
