"""The tdmpc agent."""
