"""Every way in which an edit goes wrong moves its figure, and only that."""

import math
from dataclasses import replace

import pytest
import torch
from edit3r_judge.edit_measures import (
    likely_part,
    made_up,
    measure_edit,
    measure_edit_in_3d,
    pieces,
    taken,
)

from edit3r.contract.instructions import Change, Colour, Instruction, Thing
from edit3r.contract.interfaces import EditToJudge, Reading, Selected
from edit3r.contract.types import Cameras, Rendering, Views

SIZE = 48
RED = (0.8, 0.1, 0.1)
PAINT_RED = Instruction(
    "paint", Thing("marked"), (Change("paint", Colour("red", RED)),)
)
REMOVE = Instruction("remove", Thing("marked"))
DEPTH = 2.0
SHIFT = 8  # pixels that the thing lies further left in the second photo


def square(left: int) -> torch.Tensor:
    mask = torch.zeros(SIZE, SIZE)
    mask[14:34, left : left + 20] = 1
    return mask


def views(images: torch.Tensor) -> Views:
    return Views(images[None], torch.eye(3).expand(1, len(images), 3, 3))


@pytest.fixture
def scene() -> EditToJudge:
    """A light square on grey in two photos, painted red."""
    masks = torch.stack([square(20), square(20 - SHIFT)])
    photos = 0.3 + 0.4 * masks[:, None].expand(-1, 3, -1, -1)
    red = torch.tensor(RED)[:, None, None].expand(2, 3, SIZE, SIZE)
    edited = torch.where(masks[:, None] > 0, red, photos)
    return EditToJudge(
        before=views(photos),
        after=views(edited),
        edited=range(2),
        instructions=(PAINT_RED,),
        selected=(),
        masks=masks[None],
        regions=masks[None, None],
    )


def figures(scene: EditToJudge, instruction: Instruction = PAINT_RED):
    return measure_edit(
        replace(scene, regions=scene.masks[None], instructions=(instruction,))
    )


def test_a_clean_edit_has_full_marks(scene):
    found = figures(scene)
    assert found.changed == 1 and found.reached == 1
    assert found.outline == pytest.approx(1)
    assert found.shares == pytest.approx((400 / SIZE**2,) * 2)
    assert found.ghost is None  # nothing was to be removed


def test_what_did_not_change_counts_against_the_edit(scene):
    images = scene.after.images.clone()
    images[:, 1] = scene.before.images[:, 1]
    assert figures(replace(scene, after=views(images[0]))).changed == pytest.approx(0.5)


def test_an_outline_through_an_even_area_follows_no_edges(scene):
    masks = scene.masks.clone()
    masks[..., 4:12, 4:44] = 1  # a leak into the grey
    found = figures(replace(scene, masks=masks))
    assert found.outline < 0.75 < figures(scene).outline


def test_where_edges_are_everywhere_an_outline_tells_nothing(scene):
    noise = torch.rand(2, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    assert figures(replace(scene, before=views(noise))).outline is None


def test_another_colour_than_was_asked_for_is_not_reached(scene):
    blue = Change("paint", Colour("blue", (0.1, 0.2, 0.8)))
    assert figures(scene, replace(PAINT_RED, changes=(blue,))).reached == 0


@pytest.mark.parametrize(
    ("colour", "reached"), [((0.8, 0.3, 0.1), 1), ((0.8, 0.6, 0.1), 0)]
)
def test_a_shade_of_the_asked_hue_is_the_colour_and_another_hue_is_not(
    scene, colour, reached
):
    orange = torch.tensor(colour)[:, None, None]
    painted = torch.where(scene.masks[0, :, None] > 0, orange, scene.before.images[0])
    assert figures(replace(scene, after=views(painted))).reached == reached


def test_reflections_that_hardly_changed_and_stay_grey_do_not_count_as_another_colour(
    scene,
):
    images = scene.after.images.clone()
    before = scene.before.images
    images[..., 14:20, :] = torch.where(  # a third of the painted square
        images[..., 14:20, :] == before[..., 14:20, :],
        before[..., 14:20, :],
        before[..., 14:20, :] - 10 / 255,
    )
    found = figures(replace(scene, after=views(images[0])))
    assert found.changed == 1 and 0.9 < found.reached < 1


@pytest.mark.parametrize(("amount", "reached"), [(1.0, 0.0), (-1.0, 1.0)])
def test_darker_is_not_brighter(scene, amount, reached):
    darker = torch.where(scene.masks[0, :, None] > 0, 0.2, scene.before.images[0])
    instruction = replace(PAINT_RED, changes=(Change("brightness", amount=amount),))
    assert figures(replace(scene, after=views(darker)), instruction).reached == reached


def test_a_removed_things_outline_that_stays_is_a_ghost(scene):
    gone = torch.full_like(scene.before.images[0], 0.3)
    assert figures(replace(scene, after=views(gone)), REMOVE).ghost == 0
    ring = gone.clone()
    for view, left in enumerate((20, 20 - SHIFT)):
        ring[view, :, 14:34, left] = ring[view, :, 14, left : left + 20] = 0.7
    ghost = figures(replace(scene, after=views(ring)), REMOVE).ghost
    assert ghost == pytest.approx(0.5, abs=0.15)


# ---- in 3D ----


@pytest.fixture
def in_3d(scene) -> EditToJudge:
    """The scene with a wall's depth, seen by two cameras beside each other that see it `SHIFT`
    pixels apart.
    """
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = SHIFT / SIZE * DEPTH
    k = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    cameras = Cameras(c2w, k, (SIZE, SIZE))
    depths = torch.full((1, 2, 1, SIZE, SIZE), DEPTH)
    rendered = Rendering(scene.after.images, torch.ones_like(depths), depths)
    return replace(scene, rendered=rendered, cameras=cameras)


def test_masks_of_one_thing_agree_and_others_do_not(in_3d):
    first = figures(in_3d)
    assert measure_edit_in_3d(first, in_3d).agreement == pytest.approx(1, abs=0.02)
    elsewhere = torch.stack([square(20), square(28)])[None]
    moved = replace(in_3d, masks=elsewhere)
    assert measure_edit_in_3d(first, moved).agreement < 0.3


def test_a_patch_of_the_old_colour_in_3d_is_measured_and_one_of_a_removal_is_not(in_3d):
    whole = measure_edit_in_3d(figures(in_3d), in_3d)
    assert whole.missed == 0
    images = in_3d.after.images.clone()
    images[:, 1, :, :24] = in_3d.before.images[:, 1, :, :24]  # its upper half
    patchy = replace(in_3d, rendered=replace(in_3d.rendered, images=images))
    found = measure_edit_in_3d(figures(in_3d), patchy)
    assert found.missed == pytest.approx(0.5, abs=0.1)
    removed = measure_edit_in_3d(figures(in_3d, REMOVE), patchy)
    assert removed.missed is None


def test_the_share_of_the_change_that_the_scene_shows(in_3d):
    first = figures(in_3d)
    assert measure_edit_in_3d(first, in_3d).shown == pytest.approx(1)
    half = (in_3d.before.images + in_3d.after.images) / 2
    faint = replace(in_3d, rendered=replace(in_3d.rendered, images=half))
    assert measure_edit_in_3d(first, faint).shown == pytest.approx(0.5)
    beside = torch.where(in_3d.masks[:, :, None] > 0, in_3d.after.images, 0.9)
    elsewhere = replace(in_3d, rendered=replace(in_3d.rendered, images=beside))
    assert measure_edit_in_3d(first, elsewhere).shown == pytest.approx(1)
    unchanged = replace(in_3d, after=in_3d.before)
    assert measure_edit_in_3d(first, unchanged).shown is None


def test_masks_that_show_no_common_surface_tell_nothing(in_3d):
    far = replace(in_3d.rendered, depths=in_3d.rendered.depths * math.nan)
    blind = replace(in_3d, rendered=replace(far, depths=torch.nan_to_num(far.depths)))
    assert measure_edit_in_3d(figures(in_3d), blind).agreement is None


def test_a_thing_that_takes_its_colour_in_part_is_told_from_one_of_two_colours(scene):
    masks, before = scene.masks[0], scene.before.images[0]
    after = before.clone()
    upper = slice(14, 24)
    after[:, :, upper] = torch.where(
        masks[:, None] > 0, 0.9 * torch.tensor(RED)[:, None, None], before
    )[:, :, upper]
    assert taken(before, after, masks) == pytest.approx(0.5)
    green = torch.tensor((0.1, 0.7, 0.1))[:, None, None]
    before[:, :, upper] = torch.where(masks[:, None] > 0, green, before)[:, :, upper]
    assert taken(before, after, masks) is None


def test_what_looks_as_asked_without_much_change_took_the_colour():
    before = torch.full((1, 3, 8, 8), 0.6)
    after = before.clone()
    after[..., :1, :] += 0.15
    masks = torch.ones(1, 8, 8)
    assert taken(before, after, masks) == pytest.approx(1 / 8)
    asked = torch.tensor([[0.62, 0.6, 0.58]])
    assert taken(before, after, masks, asked) == 1


def test_pieces_beside_the_largest_count():
    whole, parted = square(20), square(20)
    parted[:, 25:35] = 0
    assert pieces(whole[None]) == 0
    assert pieces(torch.stack([whole, parted])) == pytest.approx(0.5)


def test_a_smooth_patch_among_texture_is_made_up_and_texture_is_not(scene):
    random = torch.Generator().manual_seed(0)
    before = torch.rand(2, 3, SIZE, SIZE, generator=random)
    masks = scene.masks[0]
    smooth = torch.where(masks[:, None] > 0, 0.5, before)
    other = torch.rand(2, 3, SIZE, SIZE, generator=random)
    textured = torch.where(masks[:, None] > 0, other, before)
    assert made_up(before, smooth, masks) == pytest.approx(400 / SIZE**2)
    assert made_up(before, textured, masks) == 0


@pytest.mark.parametrize(
    ("how", "thing", "counts"),
    [
        ("marked", Thing("marked"), True),
        ("given", Thing("marked"), False),  # the user's own mask
        ("marked", Thing("marked", "wall"), False),  # a name says how far it goes
        ("marked", Thing("background"), False),
    ],
)
def test_how_much_a_click_took_counts_where_nothing_else_says_how_far_it_goes(
    scene, how, thing, counts
):
    selected = Selected(scene.masks[0][:, None], (how, "geometry"))
    clicked = replace(scene, selected=(selected,))
    found = figures(clicked, replace(PAINT_RED, thing=thing))
    assert (found.clicked is not None) == counts


def test_a_place_of_the_picture_needs_no_edge_at_its_outline(scene):
    half = Selected(scene.masks[0][:, None], ("region", "geometry"))
    found = figures(replace(scene, selected=(half,)))
    assert found.outline is None and found.open_outline is None
    assert found.changed == 1


@pytest.mark.parametrize(
    ("colour", "likely"), [((0.3, 0.3, 0.3), None), ((0.2, 0.5, 0.2), 0.8)]
)
def test_a_part_of_another_colour_may_be_all_that_is_meant(colour, likely):
    """A fox on its plaque, which is taken along; a bear on a plinth of its own stone is one."""
    photo = torch.full((1, 3, 60, 60), 0.9)
    photo[..., 10:50, 10:50] = 0.3
    photo[..., 10:36, 10:50] = torch.tensor(colour)[:, None, None]
    whole, part = torch.zeros(2, 60, 60)
    whole[10:50, 10:50] = 1
    part[10:36, 10:50] = 1
    readings = (Reading(0, whole, 0.5, 1), Reading(0, part, 0.4, 2))
    clicked = Selected(whole[None, None], ("marked",), readings=readings)
    expected = (0.0, 1) if likely is None else (pytest.approx(likely), 2)
    assert likely_part(photo, [clicked]) == expected
