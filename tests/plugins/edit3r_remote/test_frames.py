"""Sizes there and back."""

import io

import pytest
import torch
from edit3r_remote.frames import ServiceFrame, decode, encode_mask, encode_png
from hypothesis import given, strategies as st
from PIL import Image

from edit3r.contract.errors import RunError

OFFERED = ((1024, 1024), (1024, 1536), (1536, 1024))


@given(st.integers(1, 3000), st.integers(1, 3000))
def test_a_photo_fits_inside_its_frame_undistorted_and_centred(height, width):
    frame = ServiceFrame.around((height, width), OFFERED)
    assert frame.size in OFFERED
    for side in (0, 1):
        assert (
            frame.corner[side] >= 0
            and frame.corner[side] + frame.inner[side] <= frame.size[side]
        )
        assert abs(2 * frame.corner[side] + frame.inner[side] - frame.size[side]) <= 1
    scale = min(frame.size[0] / height, frame.size[1] / width)
    for side, length in zip(frame.inner, (height, width)):
        assert abs(side - max(1, scale * length)) <= 0.5 + 1e-6


@pytest.mark.parametrize("size", [(48, 64), (64, 48), (30, 100), (50, 50), (1, 7)])
def test_enclosing_and_extracting_gives_the_photo_back(size):
    offered = ((96, 96), (96, 144), (144, 96))
    photo = torch.linspace(0.2, 0.8, size[0])[:, None] * torch.linspace(
        0.5, 1, size[1]
    ).expand(3, 1, size[1])
    frame = ServiceFrame.around(size, offered)
    enclosed = frame.enclose(photo)
    assert enclosed.shape[1:] == frame.size
    assert torch.allclose(frame.extract(enclosed), photo, atol=0.02)


def test_png_round_trip_is_exact_to_a_byte():
    photo = torch.rand(3, 5, 7)
    picture, remark = decode(encode_png(photo), (5, 7), "view 0")
    assert remark == "" and torch.allclose(picture, photo, atol=0.5 / 255 + 1e-6)


def test_a_softly_masked_pixel_may_change():
    mask, _ = decode(
        encode_mask(torch.tensor([[0.0, 0.1], [0.9, 1.0]])), (2, 2), "mask"
    )
    assert torch.equal(mask[0], torch.tensor([[1.0, 0.0], [0.0, 0.0]]))


def test_what_is_no_picture_is_quoted():
    with pytest.raises(
        RunError, match=r"view 3 is not an image \(5 bytes, starting 'hello'\)"
    ):
        decode(b"hello", (5, 7), "view 3")


def test_a_picture_of_another_shape_is_told_before_it_is_decoded(monkeypatch):
    content = io.BytesIO()
    Image.new("RGB", (40, 20)).save(content, "PNG")
    monkeypatch.setattr(Image.Image, "load", lambda self: pytest.fail("decoded"))
    with pytest.raises(RunError, match="another shape"):
        decode(content.getvalue(), (40, 40), "a.png")
    with pytest.raises(RunError, match="far too many pixels"):
        decode(content.getvalue(), (5, 5), "a.png")
