"""Discs and lines from scans, and gaps to the footprint of a robot."""
