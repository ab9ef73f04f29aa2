"""A disk on which there is only so much room."""

import contextlib
import resource

import imageio_ffmpeg


@contextlib.contextmanager
def room_for(size):
    """No file grows beyond ``size`` bytes: an OSError, here and in ffmpeg, as of a full disk."""
    # Is looked for before: some kernels count by the limit what ffmpeg tells /dev/null of itself.
    imageio_ffmpeg.get_ffmpeg_exe()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
