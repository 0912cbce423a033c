"""Pictures of an editor that do not lie on their photos are moved back, or named."""

import cv2
import numpy as np
import pytest
import torch

from edit3r.kit.photos.images import load_views, packaged_pair
from edit3r.running.edit_alignment import align_edit

NAMES = ("left", "right")


@pytest.fixture(scope="module")
def photos():
    return load_views(packaged_pair()[0], size=256).images


def as_pixels(image):
    return image.movedim(0, -1).numpy().copy()


def as_image(pixels):
    return torch.from_numpy(np.ascontiguousarray(pixels, np.float32)).movedim(-1, 0)


def painted(pixels):
    """Red for blue: as an honest edit does."""
    return np.ascontiguousarray(pixels[..., ::-1])


def moved(pixels, right=0.0, down=0.0, zoom=1.0, turn=0.0):
    height, width = pixels.shape[:2]
    middle = ((width - 1) / 2, (height - 1) / 2)
    matrix = cv2.getRotationMatrix2D(middle, turn, zoom)
    matrix[:, 2] += (right, down)
    return cv2.warpAffine(pixels, matrix, (width, height), flags=cv2.INTER_CUBIC)


def with_bar(pixels):
    pixels[:, 150:] = 0
    return pixels


def drawn(pixels):
    """Dark lines on white paper where the photo has edges."""
    grey = cv2.GaussianBlur(pixels.mean(-1), (0, 0), 1.0)
    slope = np.hypot(*np.gradient(grey))
    return np.repeat((1 - 12 * slope).clip(0, 1)[..., None], 3, -1)


def bent(pixels):
    rows, columns = np.mgrid[: pixels.shape[0], : pixels.shape[1]].astype(np.float32)
    places = columns + 4 * np.sin(rows / 30), rows + 4 * np.sin(columns / 30)
    return cv2.remap(pixels, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def noise(pixels):
    return np.random.default_rng(0).random(pixels.shape)


def found(photos, left):
    """What is found of a left edit beside an honest right one."""
    right = as_image(painted(as_pixels(photos[0, 1])))
    return align_edit(photos, torch.stack([left, right])[None], NAMES, False)


@pytest.mark.parametrize(
    "move, said",
    [
        (lambda one: moved(one, 5, -3), "shifted by 5.0 px to the right and 3.0 px up"),
        (lambda one: moved(one, 51, 0), "shifted by 51"),
        (lambda one: moved(one, zoom=1.03), "zoomed 1.030 times"),
        (lambda one: moved(one, turn=4), "turned by -4.0 degrees"),
        (lambda one: one[::-1, ::-1], "turned by"),
        (lambda one: one[:, ::-1], "mirrored"),
    ],
)
def test_a_motion_is_undone_and_said(photos, move, said):
    honest = painted(as_pixels(photos[0, 0]))
    result = found(photos, as_image(move(honest)))
    assert not result.faults and len(result.moved) == 1
    assert result.moved[0].startswith("left was ") and said in result.moved[0]
    apart = (result.images[0, 0] - as_image(honest)).abs()
    assert apart.mean() < 0.04  # and 0.2 where it stays
    assert torch.equal(result.images[0, 1], as_image(painted(as_pixels(photos[0, 1]))))


def test_a_line_drawing_that_moved_is_moved_back(photos):
    drawing = drawn(as_pixels(photos[0, 0]))
    result = found(photos, as_image(moved(drawing, 6, -4)))
    assert not result.faults and "px to the right and 4.0 px up" in result.moved[0]


@pytest.mark.parametrize(
    "spoil, said",
    [
        (np.zeros_like, "the editor returned a black picture for left"),
        (np.ones_like, "the editor returned a picture of one colour for left"),
        (noise, "the edit of left shows nothing of its photo"),
        (with_bar, "the right 41% of the edit of left are one colour"),
        (lambda one: moved(one, 100, 0), "left shows 61% of its photo only"),
        (bent, "the edit of left lies about 4 px beside its photo"),
    ],
)
def test_what_no_motion_explains_is_named(photos, spoil, said):
    left = as_image(spoil(painted(as_pixels(photos[0, 0]))))
    result = found(photos, left)
    assert not result.moved and torch.equal(result.images[0, 0], left)
    assert len(result.faults) == 1 and said in result.faults[0]


def test_swapped_edits_are_named(photos):
    edits = torch.stack(
        [as_image(painted(as_pixels(one))) for one in photos[0].flip(0)]
    )
    result = align_edit(photos, edits[None], NAMES, False)
    assert result.faults == (
        "the edit of left shows the photo right",
        "the edit of right shows the photo left",
    )


HONEST = {
    "inverted": lambda one: 1 - one,
    "fog": lambda one: 0.3 * one + 0.65,
    "grey": lambda one: one.mean(0, keepdim=True).expand_as(one),
    "two tones": lambda one: (one.mean(0, keepdim=True) > 0.45).float().expand_as(one),
    "blurred": lambda one: as_image(cv2.GaussianBlur(as_pixels(one), (0, 0), 1.5)),
    "line drawing": lambda one: as_image(drawn(as_pixels(one))),
    "background removed": lambda one: torch.where(DISC, one, torch.ones_like(one)),
}
rows, columns = torch.meshgrid(torch.arange(173), torch.arange(256), indexing="ij")
DISC = ((rows - 90) / 60) ** 2 + ((columns - 125) / 90) ** 2 < 1


@pytest.mark.parametrize("name", HONEST)
def test_strong_honest_edits_stay_as_they_are(photos, name):
    edits = torch.stack([HONEST[name](one) for one in photos[0]])[None]
    result = align_edit(photos, edits, NAMES, False)
    assert not result.moved and not result.faults and result.images is edits


def test_a_part_that_is_used_may_be_unlike_its_photo(photos):
    edits = torch.rand(photos.shape, generator=torch.Generator().manual_seed(0))
    assert not align_edit(photos, edits, NAMES, confined=True).faults
