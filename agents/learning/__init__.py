"""What the agents with learned networks share, from scans to checkpoints."""
