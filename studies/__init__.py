"""Studies that come with crowdbench, found through the entry-point group ``crowdbench.studies``."""
