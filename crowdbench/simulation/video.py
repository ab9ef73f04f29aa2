"""Writing frames as a GIF or an MP4."""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import GifImagePlugin, Image

from crowdbench.replacing import replacing

Frame = NDArray[np.uint8]

GIF_COLORS = 64
"""Flat drawings need few colours; a small palette halves a GIF."""
_UNCHANGED = GIF_COLORS
"""Stands, after the colours, for a pixel that stays as it was."""

PALETTE_FRAMES = 8
"""How many frames, spread over the video, the palette of a GIF is chosen from."""
_FAILED = "ffmpeg has failed, perhaps since the disk is full"


def write_video(frames: Iterable[Frame], path: str | Path, fps: float) -> Path:
    """Write a video; the suffix says which kind.

    Args:
        frames: pictures (height, width, 3) uint8, all of one size.
        path: where to, ending in ``.gif`` or ``.mp4``; missing folders are made.
        fps: frames per second. A GIF rounds the time per frame to 0.01 s.

    Raises:
        ValueError: another suffix, no frames, or frames that are not pictures of one size.
        OSError: it cannot be written; a video that was there stays.
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
    with replacing(path) as part:
        write(chain([first], checked), part, fps)
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


class CompressedFrames:
    """Pictures kept at a few per cent of their size; each is unpacked when asked for."""

    def __init__(self, frames: Iterable[Frame] = ()) -> None:
        self._packed: list[tuple[bytes, tuple[int, ...]]] = []
        for frame in frames:
            self.append(frame)

    def append(self, frame: Frame) -> None:
        """Keep one more picture (height, width, 3) uint8."""
        self._packed.append((zlib.compress(frame.tobytes(), level=1), frame.shape))

    def __len__(self) -> int:
        return len(self._packed)

    def __getitem__(self, index: int) -> Frame:
        packed, shape = self._packed[index]
        return np.frombuffer(zlib.decompress(packed), np.uint8).reshape(shape)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.__getitem__, range(len(self)))


def _write_gif(frames: Iterable[Frame], path: Path, fps: float) -> None:
    """Write picture by picture: Pillow's own ``save`` holds all of them at once."""
    kept = CompressedFrames(frames)
    chosen = np.linspace(0, len(kept) - 1, min(len(kept), PALETTE_FRAMES)).round().astype(int)
    sample = Image.fromarray(np.vstack([kept[index] for index in chosen.tolist()]))
    palette = sample.quantize(GIF_COLORS, method=Image.Quantize.MEDIANCUT)
    duration = max(20, round(100 / fps) * 10)  # ms; shorter times are ignored by viewers
    with path.open("wb") as file:
        before = None
        for frame in kept:
            # Without dithering a still region stays the same from frame to frame, costing nothing.
            image = Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
            now = np.asarray(image)
            if before is None:
                file.writelines(_gif_header(palette, image.size, duration))
                pieces = GifImagePlugin.getdata(Image.fromarray(now), duration=duration)
            else:
                piece, corner = _changed(now, before)
                pieces = GifImagePlugin.getdata(
                    Image.fromarray(piece), corner, duration=duration,
                    transparency=_UNCHANGED, disposal=1,
                )  # fmt: skip
            file.writelines(pieces)
            before = now
        file.write(b";")


def _gif_header(palette: Image.Image, size: tuple[int, int], duration: int) -> list[bytes]:
    blank = Image.new("P", size)
    colors = palette.getpalette() or []
    blank.putpalette(colors[: 3 * GIF_COLORS] + [0] * (6 * GIF_COLORS - len(colors)))
    header, _ = GifImagePlugin.getheader(blank, info={"loop": 0, "duration": duration})
    return header


def _changed(now: Frame, before: Frame) -> tuple[Frame, tuple[int, int]]:
    """The rectangle that changed, transparent where it did not, and its upper left corner."""
    differs = now != before
    if not differs.any():
        return np.full((1, 1), _UNCHANGED, np.uint8), (0, 0)
    rows, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    piece = np.where(differs[box], now[box], np.uint8(_UNCHANGED))
    return piece, (int(columns[0]), int(rows[0]))


def _write_mp4(frames: Iterable[Frame], path: Path, fps: float) -> None:
    import imageio_ffmpeg

    frames = iter(frames)
    first = _even(next(frames))
    height, width, _ = first.shape
    writer = imageio_ffmpeg.write_frames(
        str(path), (width, height), fps=fps, codec="libx264", quality=8, macro_block_size=2
    )
    writer.send(None)
    sent = 0
    with contextlib.closing(writer):
        for frame in chain([first], map(_even, frames)):
            try:
                writer.send(np.ascontiguousarray(frame))
            except OSError as error:
                raise OSError(_FAILED) from error
            sent += 1
    # Nobody is told where ffmpeg fails only when all frames have been sent.
    try:
        stored, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError as error:
        raise OSError(_FAILED) from error
    if stored != sent:
        raise OSError(_FAILED)


def _even(frame: Frame) -> Frame:
    """Repeat the last row or column where a side is odd, which the codec refuses."""
    height, width, _ = frame.shape
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
