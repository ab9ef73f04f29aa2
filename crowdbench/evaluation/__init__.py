"""Running agents through episodes and turning the logs into numbers."""
