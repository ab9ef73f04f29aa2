"""Recordings of real people: read from the field's formats, cleaned, summed up and drawn.

``read_recording`` gives a ``CrowdRecording`` in metres and seconds, whatever the file has.
Not to be confused with the recordings of robots' drives in ``crowdbench.evaluation``.
"""

from crowdbench.people.errors import RecordingError
from crowdbench.people.reading import read_recording
from crowdbench.people.recording import CrowdRecording

__all__ = ["CrowdRecording", "RecordingError", "read_recording"]
