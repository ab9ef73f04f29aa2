"""The planners that come with crowdbench, each found by name."""
