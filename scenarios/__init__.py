"""The scenarios that come with crowdbench, one YAML file each."""
