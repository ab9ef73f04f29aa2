"""The neupan agent."""
