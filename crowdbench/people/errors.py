"""What is wrong with a recording of people."""


class RecordingError(ValueError):
    """A recording that cannot be used; the message names the file, the place and what is asked."""
