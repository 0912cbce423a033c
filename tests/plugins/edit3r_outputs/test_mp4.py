"""H.264 by PyAV: read back by FFmpeg's decoder, and played by a browser that can."""

import math

import numpy as np
import pytest

from edit3r import default_registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite

av = pytest.importorskip("av", reason='needs PyAV: pip install "edit3r[mp4]"')


def frames(count, height, width):
    rows, columns = np.mgrid[0:height, 0:width]
    for index in range(count):
        shade = np.stack((255 * rows / height, 255 * columns / width), -1)
        yield np.dstack((shade, np.full((height, width), 255 * index / count))).astype(
            np.uint8
        )


def write(path, pictures, **settings):
    writer = default_registry().build("writer", "mp4", **settings)
    writer.write(path, SceneToWrite(None, frames=lambda: iter(pictures)))


@pytest.mark.parametrize("size", [(48, 64), (33, 47)])
def test_every_frame_is_there_in_order(tmp_path, size):
    given = list(frames(20, *size))
    write(tmp_path / "a.mp4", given, fps=12)
    with av.open(str(tmp_path / "a.mp4")) as file:
        stream = file.streams.video[0]
        assert stream.codec_context.name == "h264" and stream.average_rate == 12
        seen = [one.to_ndarray(format="rgb24") for one in file.decode(stream)]
    height, width = size
    even = (height + height % 2, width + width % 2)
    assert len(seen) == 20 and seen[0].shape[:2] == even
    for a, b in zip(given, seen):
        error = (a.astype(float) - b[:height, :width]) / 255
        assert -10 * math.log10((error**2).mean()) > 28


def test_a_browser_can_begin_before_it_has_all_and_knows_the_colours(tmp_path):
    write(tmp_path / "a.mp4", list(frames(5, 32, 32)))
    content = (tmp_path / "a.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")
    with av.open(str(tmp_path / "a.mp4")) as file:
        context = file.streams.video[0].codec_context
        tags = (context.colorspace, context.color_primaries, context.color_trc)
    assert tuple(map(int, tags)) == (1, 1, 1) and int(context.color_range) == 1


def test_the_same_frames_give_the_same_bytes(tmp_path):
    for name in ("a.mp4", "b.mp4"):
        write(tmp_path / name, list(frames(5, 32, 32)))
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_no_frame_is_refused(tmp_path):
    with pytest.raises(InputError, match="at least one frame"):
        write(tmp_path / "a.mp4", [])
