"""The informed agent."""
