"""Writing frames as a GIF or an MP4."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Frame = NDArray[np.uint8]

GIF_COLORS = 64
"""Flat drawings need few colours; a small palette halves a GIF."""

PALETTE_FRAMES = 8
"""How many frames, spread over the video, the palette of a GIF is chosen from."""


def write_video(frames: Iterable[Frame], path: str | Path, fps: float) -> Path:
    """Write a video; the suffix says which kind.

    Args:
        frames: pictures (height, width, 3) uint8, all of one size.
        path: where to, ending in ``.gif`` or ``.mp4``; missing folders are made.
        fps: frames per second. A GIF rounds the time per frame to 0.01 s.

    Raises:
        ValueError: another suffix, no frames, or frames that are not pictures of one size.
    """
    path = Path(path)
    write = {".gif": _write_gif, ".mp4": _write_mp4}.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"video {str(path)!r}: unknown suffix {path.suffix!r}; known: .gif, .mp4")
    if not fps > 0:
        raise ValueError(f"video {str(path)!r}: fps must be positive, got {fps}")
    checked = _checked(frames, path)
    first = next(checked, None)
    if first is None:
        raise ValueError(f"video {str(path)!r}: there are no frames to write")
    path.parent.mkdir(parents=True, exist_ok=True)
    write(chain([first], checked), path, fps)
    return path


def _checked(frames: Iterable[Frame], path: Path) -> Iterator[Frame]:
    shape = None
    for index, frame in enumerate(frames):
        if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
            raise ValueError(
                f"video {str(path)!r}: frame {index} is {frame.dtype} {frame.shape}; "
                "expected uint8 (height, width, 3)"
            )
        shape = shape or frame.shape
        if frame.shape != shape:
            raise ValueError(
                f"video {str(path)!r}: frame {index} is {frame.shape}, the first one {shape}"
            )
        yield frame


def _write_gif(frames: Iterable[Frame], path: Path, fps: float) -> None:
    images = [Image.fromarray(frame) for frame in frames]
    chosen = np.linspace(0, len(images) - 1, min(len(images), PALETTE_FRAMES)).round().astype(int)
    sample = Image.fromarray(np.vstack([np.asarray(images[index]) for index in chosen]))
    palette = sample.quantize(GIF_COLORS, method=Image.Quantize.MEDIANCUT)
    # Without dithering a still region stays the same from frame to frame and costs nothing.
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    duration = max(20, round(100 / fps) * 10)  # ms; shorter times are ignored by viewers
    small[0].save(
        path, save_all=True, append_images=small[1:], duration=duration, loop=0, optimize=False
    )


def _write_mp4(frames: Iterable[Frame], path: Path, fps: float) -> None:
    import imageio_ffmpeg

    frames = iter(frames)
    first = _even(next(frames))
    height, width, _ = first.shape
    writer = imageio_ffmpeg.write_frames(
        str(path), (width, height), fps=fps, codec="libx264", quality=8, macro_block_size=2
    )
    writer.send(None)
    try:
        for frame in chain([first], map(_even, frames)):
            writer.send(np.ascontiguousarray(frame))
    finally:
        writer.close()


def _even(frame: Frame) -> Frame:
    """Repeat the last row or column where a side is odd, which the codec refuses."""
    height, width, _ = frame.shape
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
