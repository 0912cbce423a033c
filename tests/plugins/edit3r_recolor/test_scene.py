from typing import ClassVar

import pytest
import torch
from edit3r_recolor import scene
from edit3r_recolor.recoloring import recolor, renormalize
from edit3r_recolor.regions import processed_views
from edit3r_recolor.scene import (
    RecoloringSettings,
    SceneRecipe,
    carry_out,
    find_regions,
    given_regions,
    make_recipe,
)

from edit3r import Views
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Segmenter, Tracks
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.kit.segmenting import AutomaticMask

HEIGHT, WIDTH, VIEWS = 24, 32, 4
NAMES = ("a", "b", "c", "d")
IMAGES = 0.2 + 0.6 * torch.rand(
    VIEWS, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0)
)
LENSES = intrinsics_from_fov(1.0, (HEIGHT, WIDTH)).expand(1, VIEWS, 3, 3)
SCENE = Views(IMAGES[None], LENSES)
SETTINGS = RecoloringSettings(filter={"min_area": 0.02, "margin": 1})


def _box_mask(x: int, y: int, width: int, height: int) -> torch.Tensor:
    mask = torch.zeros(HEIGHT, WIDTH)
    mask[y : y + height, x : x + width] = 1
    return mask


class Boxes(Segmenter):
    """Two overlapping boxes and one at the border; `seen` says which of the first two each view
    shows.
    """

    BOXES = ((4, 4, 10, 8), (10, 6, 12, 10), (0, 0, 8, 8))
    seen: ClassVar = ((0, 1), (0, 1), (), (0,))

    def masks(self, image, clicks, box=None, before=None):
        raise NotImplementedError

    def track(self, images, masks):
        logits = (12 * masks - 6).expand(len(images), -1, -1, -1).clone()
        for view, seen in enumerate(self.seen):
            for number in set(range(len(masks))) - set(seen):
                logits[view, number] = -6
        return Tracks(logits, (logits > 0).flatten(2).any(2))


@pytest.fixture(autouse=True)
def boxes(monkeypatch):
    """What a grid of clicks finds."""
    found = tuple(AutomaticMask(_box_mask(*box)) for box in Boxes.BOXES)
    monkeypatch.setattr(scene, "automatic_masks", lambda *asked: found)


def _recipe(seed: int = 0, settings: RecoloringSettings = SETTINGS):
    found = find_regions(SCENE, Boxes(), settings)
    return found, make_recipe(IMAGES, NAMES, found, settings, seed, "test")


def test_proposals_are_filtered_followed_and_keep_their_ids():
    found, recipe = _recipe()
    assert found.rejected == {"margin": 1}
    assert [region.id for region in recipe.regions] == [1, 2]
    assert [view.objects for view in recipe.views] == [(1, 2), (1, 2), (), (1,)]
    assert [view.overlap for view in recipe.views] == [1, 1, 0, 0.5]
    assert recipe.processed == [0, 1, 3]


def test_every_region_has_one_transform_for_all_views():
    """The equation of section 3.2, from the recipe's parameters."""
    found, recipe = _recipe()
    pictures = carry_out(IMAGES, found.masks, recipe)
    weights = renormalize(found.masks)
    for index, view in enumerate(recipe.processed):
        expected = IMAGES[view].clone()
        for region, weight in zip(recipe.regions, weights[:, view]):
            expected += weight * (
                recolor(IMAGES[view], region.parameters) - IMAGES[view]
            )
        assert torch.allclose(pictures[index], expected, atol=1e-6)


def test_a_recipe_read_back_makes_the_same_pictures(tmp_path):
    found, recipe = _recipe(
        3, SETTINGS.model_copy(update={"mask_jitter": 1.0, "palette_jitter": 1.0})
    )
    recipe.save(tmp_path / "recolor.json")
    again = SceneRecipe.load(tmp_path / "recolor.json")
    assert again == recipe
    for faults in (False, True):
        first, second = (
            carry_out(IMAGES, found.masks, one, faults) for one in (again, recipe)
        )
        assert torch.equal(first, second)


def test_two_regions_have_two_transforms():
    first, second = _recipe()[1].regions
    assert first.parameters != second.parameters


def test_the_seed_decides_the_colours():
    assert _recipe(1)[1] == _recipe(1)[1]
    assert _recipe(1)[1].regions[0].parameters != _recipe(2)[1].regions[0].parameters


def test_a_region_s_colours_do_not_depend_on_how_many_others_there_are():
    fewer = SETTINGS.model_copy(update={"max_objects": 1})
    assert _recipe(0, fewer)[1].regions == _recipe()[1].regions[:1]


def test_faults_spoil_the_augmented_pictures_only_near_their_regions():
    always = SETTINGS.model_copy(update={"mask_jitter": 1.0, "palette_jitter": 1.0})
    found, recipe = _recipe(0, always)
    assert all(
        set(view.faults) == set(view.objects) for view in recipe.views if view.processed
    )
    clean, faulty = (
        carry_out(IMAGES, found.masks, recipe),
        carry_out(IMAGES, found.masks, recipe, with_faults=True),
    )
    change = (clean - faulty).abs().amax((0, 1))
    assert change.max() > 0.01
    assert not change[:, 28:].any()


def test_without_faults_the_augmented_pictures_are_the_plain_ones():
    never = SETTINGS.model_copy(update={"mask_jitter": 0.0, "palette_jitter": 0.0})
    found, recipe = _recipe(0, never)
    assert torch.equal(
        carry_out(IMAGES, found.masks, recipe),
        carry_out(IMAGES, found.masks, recipe, with_faults=True),
    )


def test_the_data_s_own_masks_go_through_the_same_filter():
    masks = torch.stack([_box_mask(*box) for box in Boxes.BOXES])[:, None].repeat(
        1, VIEWS, 1, 1
    )
    masks[0, 2:] = 0
    found = given_regions(masks, SETTINGS)
    assert found.rejected == {"margin": 1}
    assert found.active.tolist() == [
        [True, True],
        [True, True],
        [False, True],
        [False, True],
    ]
    assert torch.equal(found.masks, masks[:2])


def test_nothing_left_after_the_filter_is_an_error_that_counts_the_reasons():
    strict = RecoloringSettings(filter={"min_area": 0.9})
    with pytest.raises(
        InputError, match=r"none of 3 proposals passes the filter \(area 3\)"
    ):
        find_regions(SCENE, Boxes(), strict)


@pytest.mark.parametrize(
    "content",
    ["", "[]", '{"format": "other"}', '{"format": "edit3r recolor 1", "regions": [1]}'],
)
def test_a_file_that_is_no_recipe_is_refused_by_name(tmp_path, content):
    path = tmp_path / "recolor.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"recolor\.json: not a recipe"):
        SceneRecipe.load(path)


def test_a_misspelt_key_in_a_recipe_is_named(tmp_path):
    path = tmp_path / "recolor.json"
    _recipe()[1].save(path)
    path.write_text(path.read_text().replace('"hue"', '"hew"', 1))
    with pytest.raises(InputError, match=r"not a recipe .*regions\.0\.parameters\.hew"):
        SceneRecipe.load(path)


@pytest.mark.parametrize("shared, used", [(1, [0]), (2, [0, 1])])
def test_by_default_a_view_that_shares_less_than_half_of_the_objects_is_left_out(
    shared, used
):
    active = torch.tensor(
        [[True, True, True], [number < shared for number in range(3)]]
    )
    assert processed_views(active, RecoloringSettings().least_overlap) == used
