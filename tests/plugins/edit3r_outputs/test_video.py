import math

import cv2
import numpy as np
import pytest
import torch
from edit3r_outputs.video import save_video

from edit3r.contract.errors import InputError


def smooth_frames(count, height, width):
    """Colour ramps that drift, so that every frame differs and codes well."""
    ys, xs = torch.meshgrid(
        torch.linspace(0, 1, height), torch.linspace(0, 1, width), indexing="ij"
    )
    return [torch.stack((xs, ys, torch.full_like(xs, i / count))) for i in range(count)]


def read_back(path):
    """Frames [height, width, 3] in [0, 1] as FFmpeg decodes them, and frames per second."""
    capture = cv2.VideoCapture(str(path))
    frames = []
    while True:
        good, frame = capture.read()
        if not good:
            break
        frames.append(frame[..., ::-1] / 255)
    fps = capture.get(cv2.CAP_PROP_FPS)
    capture.release()
    return frames, fps


@pytest.mark.parametrize("size", [(48, 64), (33, 47)])
def test_independent_decoder_sees_every_frame(tmp_path, size):
    frames = smooth_frames(30, *size)
    save_video(tmp_path / "a.webm", iter(frames), fps=24)
    decoded, fps = read_back(tmp_path / "a.webm")
    assert len(decoded) == 30 and fps == pytest.approx(24, abs=0.01)
    for given, seen in zip(frames, decoded):
        error = seen - given.permute(1, 2, 0).numpy()
        assert -10 * math.log10((error**2).mean()) > 32


def test_frames_after_the_first_second_are_in_further_clusters_and_can_be_sought(
    tmp_path,
):
    frames = [torch.full((3, 32, 32), i / 100) for i in range(100)]
    save_video(tmp_path / "a.webm", frames, fps=20)
    capture = cv2.VideoCapture(str(tmp_path / "a.webm"))
    capture.set(cv2.CAP_PROP_POS_FRAMES, 70)
    good, frame = capture.read()
    assert good and frame.mean() / 255 == pytest.approx(0.7, abs=0.02)


def test_same_frames_give_the_same_bytes(tmp_path):
    for name in ("a.webm", "b.webm"):
        save_video(tmp_path / name, smooth_frames(3, 16, 16))
    assert (tmp_path / "a.webm").read_bytes() == (tmp_path / "b.webm").read_bytes()


def test_values_beyond_the_range_are_clipped_and_one_pixel_is_enough(tmp_path):
    save_video(tmp_path / "a.webm", [torch.full((3, 1, 1), 5.0)])
    decoded, _ = read_back(tmp_path / "a.webm")
    np.testing.assert_allclose(decoded[0], 1, atol=0.01)


def test_wrong_suffix_no_frames_and_mixed_sizes_are_errors(tmp_path):
    frame = torch.zeros(3, 8, 8)
    with pytest.raises(InputError, match=r"a\.avi: videos are written as \.webm"):
        save_video(tmp_path / "a.avi", [frame])
    with pytest.raises(InputError, match="at least one frame"):
        save_video(tmp_path / "a.webm", [])
    with pytest.raises(InputError, match="share one size"):
        save_video(tmp_path / "a.webm", [frame, torch.zeros(3, 8, 9)])
    with pytest.raises(InputError, match="frames per second"):
        save_video(tmp_path / "a.webm", [frame], fps=0)
    assert not list(tmp_path.iterdir())
