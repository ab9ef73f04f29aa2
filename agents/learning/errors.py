"""What stops a training."""

from __future__ import annotations


class TrainingError(RuntimeError):
    """Training cannot go on; the message says why and what helps."""
