"""Paint changes a thing's own colour and nothing else on it.

`data/paint.json` has outlines drawn by hand on packaged photos, in pixels of a photo that is
`width` wide: `thing` (the motorcycle's is its packaged mask), `paint` without `cut` (badges and
lamps), and `neutral` (rubber, leather, chrome, white). Mirror images of paint are in neither.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage.data
import torch
from edit3r_recolor.oklab import rgb_to_oklab
from edit3r_recolor.paint import own_paint, paint
from hypothesis import given, settings, strategies as st

import edit3r
from edit3r.kit.compute.colour_names import BASIC_COLOURS, read_colour
from edit3r.kit.photos.images import packaged_pair

OUTLINES = json.loads((Path(__file__).parent / "data/paint.json").read_text())
MASKS = Path(edit3r.__file__).parent / "kit/photos"
VISIBLE = 5 / 255
SURFACES = [(0.5, 0.4, 0.3), (0.05, 0.05, 0.06), (0.95, 0.95, 0.9), (0.1, 0.2, 0.8)]


@dataclass
class Target:
    images: torch.Tensor  # [view 3 height width]
    region: torch.Tensor  # [view height width]
    paint: torch.Tensor  # the same, bool
    neutral: torch.Tensor  # the same, bool


def outlined(name: str, photo: np.ndarray, mask: np.ndarray | None = None) -> Target:
    """A photo [height width 3] in sRGB bytes, with its outlines filled."""
    outlines = OUTLINES[name]
    width = outlines["width"]
    size = (width, round(photo.shape[0] * width / photo.shape[1]))
    photo = cv2.resize(photo, size, interpolation=cv2.INTER_AREA)

    def filled(kind: str) -> torch.Tensor:
        canvas = np.zeros(photo.shape[:2], np.uint8)
        for polygon in outlines[kind]:
            cv2.fillPoly(canvas, [np.array(polygon)], 1)
        return torch.from_numpy(canvas)[None] > 0

    if mask is None:
        region = filled("thing").float()
    else:
        mask = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
        region = torch.from_numpy(mask)[None] / 255
    image = torch.from_numpy(photo).movedim(-1, 0)[None] / 255
    painted = filled("paint") & ~filled("cut") & (region > 0.5)
    return Target(image, region, painted, filled("neutral") & (region > 0.5))


def motorcycle() -> Target:
    sides = []
    for path, mask in zip(packaged_pair()[0], ("", "_right")):
        photo = cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
        mask = cv2.imread(str(MASKS / f"motorcycle_mask{mask}.png"), 0)
        sides.append(outlined(Path(path).stem, photo, mask))
    return Target(
        *(torch.cat(part) for part in zip(*(vars(s).values() for s in sides)))
    )


def ball() -> Target:
    """A glossy blue ball with a rubber band and a chrome ring, lit from the upper left."""
    rows, columns = torch.meshgrid(*[torch.linspace(-1, 1, 128)] * 2, indexing="ij")
    depth = (0.9**2 - rows**2 - columns**2).clamp(min=0).sqrt()
    light = ((-0.5 * rows - 0.4 * columns + 0.75 * depth) / 0.9).clamp(0.05, 1)
    band, ring = (rows - 0.1).abs() < 0.15, (rows + 0.45).abs() < 0.08
    linear = torch.tensor([0.02, 0.08, 0.6])[:, None, None] * light
    linear[:, band] = 0.02 * light[band]
    linear[:, ring] = 0.7 * light[ring] ** 3
    noise = torch.randn(3, 128, 128, generator=torch.Generator().manual_seed(0))
    image = (linear + 0.5 * light**60).clamp(0, 1) ** (1 / 2.2) + 0.01 * noise
    inside = depth > 0.2
    paint, neutral = inside & ~band & ~ring, inside & (band | ring)
    one = (image.clamp(0, 1), inside.float(), paint, neutral)
    return Target(*(part[None] for part in one))


THINGS = {
    "red motorcycle": motorcycle,
    "orange suit": lambda: outlined("astronaut", skimage.data.astronaut()),
    "brown cup": lambda: outlined("coffee", skimage.data.coffee()),
    "blue ball": ball,
}


@pytest.fixture(scope="module", params=THINGS)
def thing(request) -> Target:
    return THINGS[request.param]()


def rgb_of(colour: str) -> tuple[float, float, float]:
    return read_colour([colour])[0].rgb


def painted(thing: Target, colour: str, **options) -> torch.Tensor:
    new = paint(thing.images, thing.region, rgb_of(colour), **options)
    return torch.lerp(thing.images, new, thing.region[:, None])


def lightness(images: torch.Tensor) -> torch.Tensor:
    return rgb_to_oklab(images)[:, 0]


def hue_error(images: torch.Tensor, colour: str) -> torch.Tensor:
    """Angle in OKLab to the hue of a colour [degrees]; 180 for what has no hue."""
    lab = rgb_to_oklab(images)
    goal = rgb_to_oklab(torch.tensor(rgb_of(colour))[:, None, None])[1:]
    chroma = lab[:, 1:].norm(dim=1)
    cosine = (lab[:, 1:] * goal).sum(1) / (chroma * goal.norm()).clamp(min=1e-6)
    angle = torch.rad2deg(torch.arccos(cosine.clamp(-1, 1)))
    return torch.where(chroma > 0.02, angle, 180)


@pytest.mark.parametrize("colour", ["blue", "green", "purple", "orange"])
def test_paint_takes_the_hue_asked_for_and_keeps_its_shading(thing, colour):
    after = painted(thing, colour)
    error = hue_error(after, colour)[thing.paint]
    assert (error < 15).float().mean() >= 0.9
    pairs = torch.stack((lightness(thing.images), lightness(after)))[:, thing.paint]
    assert torch.corrcoef(pairs)[0, 1] >= 0.95


@pytest.mark.parametrize("colour", ["blue", "green", "white", "black"])
def test_what_is_neutral_stays(thing, colour):
    moved = (painted(thing, colour) - thing.images).abs().amax(1) > VISIBLE
    assert moved[thing.neutral].float().mean() <= 0.03


def test_all_of_it_paints_what_is_neutral_too(thing):
    moved = (painted(thing, "green", flood=True) - thing.images).abs().amax(1) > VISIBLE
    assert moved[thing.neutral].float().mean() > 0.6  # some of it is black


def shaded(rgb=(0.5, 0.4, 0.3)) -> torch.Tensor:
    """A surface of one colour in light that falls off from left to right, 1 view of 16x16."""
    light = torch.linspace(1, 0.4, 16)[None, None, None, :].expand(1, 3, 16, 16)
    return torch.tensor(rgb)[None, :, None, None] * light


ALL = torch.ones(1, 16, 16)


@pytest.mark.parametrize("surface", [(0.4, 0.4, 0.4), (0.9, 0.9, 0.88)])
def test_a_grey_or_white_thing_is_painted_whole(surface):
    noise = torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    before = (shaded(surface) + 0.01 * noise).clamp(0, 1)
    after = paint(before, ALL, rgb_of("red"))
    assert (hue_error(after, "red") < 15).all()


def test_a_thing_of_many_colours_is_painted_whole():
    noise = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    after = paint(noise, torch.ones(1, 64, 64), rgb_of("green"))
    assert (hue_error(after, "green") < 15).float().mean() > 0.9


def test_metal_has_more_contrast_and_coloured_highlights(thing):
    gold = (0.86, 0.62, 0.16)
    plain = paint(thing.images, thing.region, gold)
    metal = paint(thing.images, thing.region, gold, metal=True)
    as_paint, as_metal = (lightness(one)[thing.paint] for one in (plain, metal))
    assert as_metal.std() > 1.2 * as_paint.std()
    chroma = rgb_to_oklab(metal)[:, 1:].norm(dim=1)[thing.paint]
    bright = as_metal > 0.8
    assert not bright.any() or chroma[bright].mean() > 0.05
    moved = (metal - thing.images).abs().amax(1) > VISIBLE
    assert moved[thing.neutral].float().mean() <= 0.03


def test_a_smaller_tolerance_narrows():
    hues = torch.linspace(0, 0.9, 16)  # red to yellow
    image = torch.stack((torch.full((16,), 0.9), hues, torch.zeros(16)))
    image = image[None, :, None, :].expand(1, 3, 16, 16)
    counts = []
    for tolerance in (6, 18, 50):
        after = paint(image, ALL, rgb_of("blue"), tolerance)
        counts.append(int(((after - image).abs().amax(1) > VISIBLE).sum()))
    assert counts == sorted(set(counts))


@pytest.mark.parametrize("colour", BASIC_COLOURS)
@pytest.mark.parametrize("surface", SURFACES)
def test_paint_keeps_the_order_of_light_and_shade(colour, surface):
    before = lightness(shaded(surface))[0, 0]
    after = lightness(paint(shaded(surface), ALL, rgb_of(colour)))[0, 0]
    assert (before.diff() < 0).all() and (after.diff() < 1e-3).all()
    assert after.max() - after.min() > 0.2 * min(0.2, float(before[0] - before[-1]))


@pytest.mark.parametrize("colour", ["red", "orange", "green", "turquoise", "purple"])
@pytest.mark.parametrize("surface", SURFACES)
def test_paint_has_the_colour_it_is_named_after(colour, surface):
    after = paint(shaded(surface), ALL, rgb_of(colour))[..., 8:9, 8:9]
    assert hue_error(after, colour) < 6
    assert (after[0, :, 0, 0] - torch.tensor(rgb_of(colour))).abs().max() < 0.25


@pytest.mark.parametrize(
    "colour, low, high", [("black", 0, 0.3), ("white", 0.82, 1), ("grey", 0.45, 0.7)]
)
@pytest.mark.parametrize("surface", [(0.7, 0.1, 0.1), *SURFACES[1:3]])
def test_black_white_and_grey_have_their_lightness_and_no_colour(
    colour, low, high, surface
):
    after = paint(shaded(surface), ALL, rgb_of(colour))
    lab = rgb_to_oklab(after)[0, :, 8, 8]
    assert low <= lab[0] <= high
    assert lab[1:].norm() < 0.02


def test_one_colour_becomes_one_colour_in_all_views():
    """View 1 shows the surface of view 0 half in shade: where colours are equal, results are."""
    views = torch.cat((shaded(), shaded()))
    views[1, :, :8] *= 0.5
    result = paint(views, ALL.expand(2, 16, 16), (0.8, 0.1, 0.1))
    assert torch.equal(result[0, :, 8:], result[1, :, 8:])


def test_paint_is_measured_in_the_region_only():
    image = shaded()
    image[..., 8:, :] = 0.9
    mask = torch.zeros(1, 16, 16)
    mask[:, :8] = 1
    half = paint(image, mask, (0.8, 0.1, 0.1))
    expected = paint(shaded(), ALL, (0.8, 0.1, 0.1))
    assert torch.allclose(half[..., :8, :], expected[..., :8, :], atol=1e-5)
    assert torch.equal(half[..., 8:, :], image[..., 8:, :])


@pytest.mark.slow
@settings(max_examples=30)
@given(st.tuples(*[st.floats(0, 1)] * 3), st.tuples(*[st.floats(0, 1)] * 3))
def test_paint_is_finite_and_in_range_for_any_colours(surface, rgb):
    result = paint(shaded(surface), ALL, rgb)
    assert torch.isfinite(result).all() and result.min() >= 0 and result.max() <= 1


def test_an_empty_region_changes_nothing():
    assert torch.equal(paint(shaded(), torch.zeros(1, 16, 16), (1.0, 0, 0)), shaded())


def test_the_hue_of_a_paint_is_measured():
    lab = rgb_to_oklab(shaded((0.1, 0.2, 0.8)).movedim(1, 0)[:, 0])
    found = own_paint(lab, ALL[0], 18, flood=False)
    assert abs(found.hue - float(torch.atan2(lab[2], lab[1]).mean())) < 0.05


@pytest.mark.parametrize(("columns", "painted"), [(2, 1.0), (5, 0.25)])
def test_a_neutral_thing_with_a_rim_of_colour_is_painted_whole(columns, painted):
    """A click on a black seat takes a little of the red beside it along, which is not its paint."""
    images = torch.full((1, 3, 20, 20), 0.25)
    images[:, :, :, :columns] = torch.tensor([0.8, 0.1, 0.1])[:, None, None]
    changed = paint(images, torch.ones(1, 20, 20), (0.1, 0.2, 0.9)) - images
    share = (changed.abs().amax(1) > 0.02).double().mean()
    assert float(share) == pytest.approx(painted, abs=0.01)


def patches(block: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A brown thing that is grey in half of its squares; and where it is brown."""
    rows, columns = torch.meshgrid(*[torch.arange(96) // block] * 2, indexing="ij")
    brown = (rows + columns) % 2 == 0
    image = torch.full((1, 3, 96, 96), 0.4)
    image[:, :, brown] = torch.tensor([0.5, 0.36, 0.25])[:, None]
    return image, brown


def test_a_thing_whose_colour_comes_and_goes_is_painted_whole_not_in_islands():
    image, _ = patches(6)
    painted = paint(image, torch.ones(1, 96, 96), rgb_of("blue"))
    assert ((painted - image).abs().amax(1) > VISIBLE).all()


def test_a_thing_whose_other_side_has_the_colour_is_painted_whole():
    """Of a guitar that is seen from all sides, the brown back is no reason to leave the front."""
    images = torch.full((2, 3, 24, 24), 0.4)
    images[1] = torch.tensor([0.5, 0.2, 0.05])[:, None, None]
    moved = (paint(images, torch.ones(2, 24, 24), rgb_of("blue")) - images).abs()
    assert (moved.amax(1) > VISIBLE).all()
    assert (
        paint(images[1:], torch.ones(1, 24, 24), rgb_of("blue")) != images[1:]
    ).any()


def test_specks_that_are_left_of_a_thing_are_painted_too():
    """Dark fur and wood lose their hue pixel by pixel: nine tenths painted look moth-eaten."""
    image = torch.full((1, 3, 96, 96), 0.4)
    image[:] = torch.tensor([0.5, 0.36, 0.25])[:, None, None]
    image[..., 2::8, 2::4] = 0.4
    image[..., 3::8, 2::4] = 0.4
    painted = paint(image, torch.ones(1, 96, 96), rgb_of("blue"))
    assert ((painted - image).abs().amax(1) > VISIBLE).all()


@pytest.mark.parametrize(("dark", "taken"), [(True, True), (False, False)])
def test_the_hue_of_dark_fur_is_noise(dark, taken):
    """A hue 40 degrees off is another colour in the light, and the same fur in the dark."""
    image = torch.tensor([0.5, 0.36, 0.25])[:, None, None].repeat(1, 1, 96, 96)
    other = torch.tensor([0.085, 0.04, 0.045] if dark else [0.5, 0.3, 0.33])
    image[..., :40, :40] = other[:, None, None]
    painted = paint(image, torch.ones(1, 96, 96), rgb_of("white"))
    moved = (painted - image).abs().amax(1)[0] > VISIBLE
    assert bool(moved[:40, :40].all()) == taken
    assert moved[40:, 40:].all()


def test_two_halves_in_two_colours_are_no_islands():
    image, brown = patches(48)
    moved = (paint(image, torch.ones(1, 96, 96), rgb_of("blue")) - image).abs().amax(1)[
        0
    ] > VISIBLE
    assert moved[brown].all() and not moved[~brown].any()


def lightness_of(images: torch.Tensor, thing: Target) -> torch.Tensor:
    return rgb_to_oklab(images)[:, 0][thing.paint]


def test_matte_paint_has_weaker_highlights_and_the_same_middle():
    thing = ball()
    rgb = read_colour(["green"])[0].rgb
    plain = lightness_of(paint(thing.images, thing.region, rgb), thing)
    matte = lightness_of(paint(thing.images, thing.region, rgb, matte=True), thing)
    assert float(matte.median()) == pytest.approx(float(plain.median()), abs=0.01)
    bright = plain > plain.quantile(0.9)
    above = plain[bright].mean() - plain.median()
    assert matte[bright].mean() - matte.median() < 0.5 * above


@pytest.mark.parametrize(
    ("name", "than_now"), [("darker blue", -1), ("lighter blue", 1)]
)
def test_a_darker_blue_is_darker_than_the_thing_was(name, than_now):
    """The ball is darker than the colour that is called "darker blue"."""
    thing = ball()
    images = thing.images ** (1.8 if than_now < 0 else 0.3)
    rgb = read_colour(name.split())[0].rgb
    before = lightness_of(images, thing).median()
    plain = lightness_of(paint(images, thing.region, rgb), thing).median()
    after = lightness_of(
        paint(images, thing.region, rgb, than_now=than_now), thing
    ).median()
    assert than_now * float(plain - before) < 0 < than_now * float(after - before)


def test_a_photo_that_hardly_shows_the_thing_says_nothing_of_its_other_side():
    """Of a thing in red and grey, one photo shows a few grey pixels at its border alone."""
    images = torch.full((2, 3, 24, 24), 0.4)
    images[0, :, :, :12] = torch.tensor([0.8, 0.1, 0.1])[:, None, None]
    region = torch.ones(2, 24, 24)
    region[1] = 0
    region[1, :4, :4] = 1
    moved = (paint(images, region, rgb_of("blue")) - images).abs().amax(1)[0] > VISIBLE
    assert moved[:, :12].all() and not moved[:, 12:].any()
