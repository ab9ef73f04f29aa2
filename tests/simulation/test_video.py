"""Videos hold the frames they were given, read back with another decoder."""

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from crowdbench.simulation.video import CompressedFrames, write_video


def frames(count=5, height=64, width=96):
    """A dark square that moves right on a light ground, 12 pixels per frame."""
    for index in range(count):
        frame = np.full((height, width, 3), 230, np.uint8)
        frame[20:36, 12 * index : 12 * index + 16] = (0, 114, 178)
        yield frame


def square(frame):
    """Column of the square's centre."""
    return np.nonzero(frame[..., 0] < 115)[1].mean()


def test_a_gif_has_every_frame_and_its_pace(tmp_path):
    path = write_video(frames(), tmp_path / "new" / "video.gif", fps=5)
    with Image.open(path) as image:
        assert (image.n_frames, image.size, image.info["loop"]) == (5, (96, 64), 0)
        for index in range(5):
            image.seek(index)
            assert image.info["duration"] == 200
            assert square(np.asarray(image.convert("RGB"))) == pytest.approx(12 * index + 7.5)


def test_a_gif_shows_what_it_was_given_within_its_palette(tmp_path):
    """Few colours are kept exactly, wherever they change, and where nothing does."""
    rng = np.random.default_rng(0)
    colors = rng.integers(0, 256, (10, 3), dtype=np.uint8)
    given = [colors[rng.integers(0, 10, (40, 50))]]
    for _ in range(6):
        given.append(given[-1].copy())
        given[-1][rng.integers(0, 20) : 30, rng.integers(0, 30) : 40] = colors[rng.integers(0, 10)]
    given.append(given[-1].copy())
    path = write_video(iter(given), tmp_path / "video.gif", fps=10)
    with Image.open(path) as image:
        assert image.n_frames == len(given)
        for index, frame in enumerate(given):
            image.seek(index)
            np.testing.assert_array_equal(np.asarray(image.convert("RGB")), frame)


def test_compressed_frames_are_the_frames():
    kept = CompressedFrames(frames())
    kept.append(next(frames()))
    assert len(kept) == 6
    for one, other in zip(kept, [*frames(), next(frames())], strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(("height", "width"), [(64, 96), (63, 95)])
def test_an_mp4_has_every_frame_and_its_pace(tmp_path, height, width):
    path = write_video(frames(height=height, width=width), tmp_path / "video.mp4", fps=5)
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    assert meta["size"] == (96, 64)
    assert meta["fps"] == 5
    decoded = [np.frombuffer(data, np.uint8).reshape(64, 96, 3) for data in reader]
    assert len(decoded) == 5
    for index, frame in enumerate(decoded):
        assert square(frame) == pytest.approx(12 * index + 7.5, abs=1)


@pytest.mark.parametrize("name", ["video.avi", "video"])
def test_an_unknown_suffix_is_refused_with_the_known_ones(tmp_path, name):
    with pytest.raises(ValueError, match=r"unknown suffix .*known: \.gif, \.mp4"):
        write_video(frames(), tmp_path / name, fps=5)
    assert not list(tmp_path.iterdir())


def test_no_frames_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="no frames"):
        write_video([], tmp_path / "video.gif", fps=5)


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_frame_of_another_size_is_named(tmp_path, suffix):
    mixed = [*frames(2), np.zeros((10, 10, 3), np.uint8)]
    with pytest.raises(ValueError, match=r"frame 2 is \(10, 10, 3\)"):
        write_video(mixed, tmp_path / f"video{suffix}", fps=5)


def test_a_frame_that_is_no_picture_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"float64 \(8, 8\)"):
        write_video([np.zeros((8, 8))], tmp_path / "video.gif", fps=5)


def test_fps_must_be_positive(tmp_path):
    with pytest.raises(ValueError, match="fps"):
        write_video(frames(), tmp_path / "video.gif", fps=0)
