"""The sac agent."""
