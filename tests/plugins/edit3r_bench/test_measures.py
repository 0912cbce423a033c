"""What is measured of one edit, where every answer is known beforehand."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from edit3r_bench.item import evaluation_cameras
from edit3r_bench.manifest import ItemRecord, LoadedItem
from edit3r_bench.measures import (
    BY_REGION,
    MethodOutput,
    measure,
    remark,
)
from edit3r_bench.run import ItemResult

from edit3r.contract.types import Cameras, Views

pytestmark = pytest.mark.slow

SIZE = 40
# rows of each region: a band of 2 pixels
EDIT, BAND, BACKGROUND = slice(0, 10), slice(10, 12), slice(12, 40)


@pytest.fixture
def item():
    """A wall two units away in two inputs and two held-back frames; its upper quarter becomes 0.2
    brighter.
    """
    generator = torch.Generator().manual_seed(0)
    texture = 0.2 + 0.4 * torch.rand(3, SIZE, SIZE + 30, generator=generator)
    places = (0, 30, 10, 20)  # pixels to the right; a pixel is 2 / 40 units wide there
    photos = torch.stack([texture[:, :, x : x + SIZE] for x in places])
    c2w = torch.eye(4).repeat(1, 4, 1, 1)
    c2w[0, :, 0, 3] = torch.tensor(places) * 2 / SIZE
    k = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, 4, 3, 3)
    masks = torch.zeros(4, SIZE, SIZE)
    masks[:, EDIT] = 1
    texts = {"prompt": "lighter", "description": "after", "before": "before"}
    record = ItemRecord(id="a", scene="s", type="Modify", inputs=(0, 3), **texts)
    views, cameras = Views(photos[None], k), Cameras(c2w, k, (SIZE, SIZE))
    depths, truth = torch.full((4, SIZE, SIZE), 2.0), photos + 0.2 * masks[:, None]
    return LoadedItem(record, views, 2, cameras, depths, truth, masks)


def squares(inputs):
    return (inputs.rendered - inputs.target).square().mean()


def words(images, texts):
    """A CLIP for which every picture shows the edit as described."""
    known = {"after": 0.3, "before": 0.1, "lighter": 0.2}
    return torch.tensor([known.get(text, 0.0) for text in texts]).expand(4, -1)


def measured(item, images, edited=None, **more):
    distances = {"perceptual": squares}
    networks = SimpleNamespace(features=[], clip=None, distances=distances)
    edited = item.truth[:2] if edited is None else edited
    output = MethodOutput(images, edited, item.depths, item.cameras, True, **more)
    return measure(item, output, networks)


def test_the_truth_itself_is_perfect_in_every_region(item):
    found = measured(item, item.truth)
    best = {"psnr": math.inf, "ssim": pytest.approx(1), "perceptual": 0}
    for name in (*BY_REGION, "psnr-in-edit"):
        if not name.startswith("lpips"):
            assert found[name] == best[name.partition("-")[0]], name
    for name in ("edit-uptake", "edit-uptake-2d"):
        assert found[name] == pytest.approx(1)


@pytest.mark.parametrize(
    ("region", "rows"),
    [("edit", EDIT), ("band", BAND), ("background", BACKGROUND)],
    ids=str,
)
def test_an_error_of_a_tenth_is_20_decibels_where_it_is_and_nothing_elsewhere(
    item, region, rows
):
    images = item.truth.clone()
    images[2:, :, rows] -= 0.1
    found = measured(item, images)
    for other in ("edit", "band", "background"):
        here = other == region
        psnr = pytest.approx(20, abs=1e-3) if here else math.inf
        squared = pytest.approx(0.01 if here else 0, abs=1e-6)
        assert found[f"psnr-in-{other}"] == psnr
        assert found[f"perceptual-in-{other}"] == squared
    assert found[f"ssim-in-{region}"] < 0.99


def test_the_whole_picture_is_the_held_back_frames_alone(item):
    images = item.truth.clone()
    images[:2] = 0  # the inputs are lost
    found = measured(item, images)
    assert found["psnr"] == found["psnr-in-edit"] == math.inf
    images = item.truth.clone()
    images[2:, :, :20] -= 0.1  # half of the picture: 0.01 / 2
    found = measured(item, images)
    assert found["psnr"] == pytest.approx(10 * math.log10(200), abs=1e-3)
    assert found["perceptual"] == pytest.approx(0.005, abs=1e-6)


def test_a_global_edit_has_no_band_and_no_background(item):
    found = measured(replace(item, masks=None), item.truth - 0.1)
    assert found["psnr-in-edit"] == pytest.approx(20, abs=1e-3) == found["psnr"]
    assert math.isnan(found["psnr-in-band"])
    assert math.isnan(found["perceptual-in-background"])


def test_disagreement_of_the_2d_edits_stands_beside_what_is_left_of_it(item):
    edited = item.truth[:2].clone()
    # the second view's edit is off by that, and the scene takes a third of it over
    edited[1] += 0.06
    images = item.truth.clone()
    images[1] += 0.02
    found = measured(item, images, edited)
    assert found["consistency-2d"] == pytest.approx(0.06, abs=1e-4)
    assert found["consistency-warped"] == pytest.approx(0.02, abs=1e-4)


def test_held_back_cameras_stand_in_the_unit_of_the_predicted_ones(item):
    """The method placed the inputs half as far apart as they are."""
    record = item.record.model_copy(update={"held_back": (1, 2)})
    true = item.cameras
    inputs = true.select(range(2))
    predicted = replace(inputs, c2w=inputs.c2w.clone())
    predicted.c2w[..., :3, 3] *= 0.5
    found = evaluation_cameras(replace(item, record=record), predicted)
    assert torch.equal(found.c2w[:, :2], predicted.c2w)
    assert torch.allclose(found.c2w[:, 2:, :3, 3], 0.5 * true.c2w[:, 2:, :3, 3])


def test_sharpness_is_that_of_the_photos_of_the_same_frames(item):
    assert measured(item, item.photos.images[0])["sharpness"] == pytest.approx(1)
    assert measured(item, item.photos.images[0] / 2)["sharpness"] == pytest.approx(0.25)


def test_clip_is_asked_for_the_text_of_after_not_of_before(item):
    networks = SimpleNamespace(features=[], clip=words, distances={})
    plain = replace(item, record=item.record.model_copy(update={"before": ""}))
    output = MethodOutput(item.truth, item.truth[:2], item.depths, item.cameras, True)
    found = measure(plain, output, networks)
    assert found["clip-t2i"] == pytest.approx(0.3)


def test_an_edit_that_ran_without_reaching_the_scene_is_said_in_words(item):
    found = measured(item, item.photos.images[0])  # the scene still shows the photos
    said = (
        "edit ran, scene unchanged: the scene shows 0% of the 2D edit (mean change 0."
    )
    assert remark(found).startswith(said)
    assert remark(measured(item, item.truth)) == ""
    unedited = measured(item, item.truth, item.photos.images[0, :2])
    assert "left the reference unchanged" in remark(unedited)
    assert ItemResult("a", "s", "Modify", found).remark == remark(found)
    assert ItemResult("a", "s", "Modify", found, failure="no matches").remark == ""
