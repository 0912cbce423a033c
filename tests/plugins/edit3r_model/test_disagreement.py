from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from edit3r_model.colour_function import change_of, fit_colour_maps
from edit3r_model.disagreement import edits_conflict, edits_disagree
from edit3r_model.edited_views import Correspondences, EditedViews, find_exposure

from edit3r.kit.geometry.cameras import pixel_grid

torch.manual_seed(0)
PHOTOS = torch.rand(2, 3, 16, 16)


def test_an_unedited_photo_has_maps_of_exactly_zero():
    assert (fit_colour_maps(PHOTOS, PHOTOS) == 0).all()


def test_an_affine_recoloring_is_found_and_reproduced():
    matrix = torch.tensor([[0.2, 0.7, 0.0], [0.5, 0.3, 0.1], [0.0, 0.2, 0.6]])
    edited = torch.einsum("ij,bjhw->bihw", matrix, PHOTOS) + 0.1
    maps = fit_colour_maps(PHOTOS, edited, sigma=2.0, ridge=1e-6)
    assert torch.allclose(PHOTOS + change_of(maps, PHOTOS), edited, atol=1e-3)


def test_a_plain_surface_gets_the_offset_and_no_slope():
    photos = torch.full((1, 3, 8, 8), 0.4)
    maps = fit_colour_maps(photos, photos + 0.2)
    assert maps[:, :9].abs().max() < 1e-3
    assert torch.allclose(maps[:, 9:], torch.full((1, 3, 8, 8), 0.2), atol=1e-4)


def test_stride_gives_one_map_a_cell():
    assert fit_colour_maps(PHOTOS, 1 - PHOTOS, stride=4).shape == (2, 12, 4, 4)


SIZE = (40, 48)
PAIR = F.interpolate(torch.rand(1, 6, 10, 12), SIZE, mode="bicubic")
PAIR = PAIR.clamp(0, 1).unflatten(1, (2, 3))
PAIR[:, 1] = PAIR[:, 0]  # one scene, seen twice from the same place
SAME_PLACE = Correspondences(
    pixel_grid(SIZE, PAIR).expand(1, 2, *SIZE, 2),
    torch.ones(1, 2, *SIZE),
    torch.zeros(1, 2, *SIZE),
)
# the reference shows no place of the other view
ELSEWHERE = replace(SAME_PLACE, inside=torch.zeros(1, 2, *SIZE))
OBJECT = torch.zeros(1, 1, *SIZE)
OBJECT[..., 10:30, 12:36] = 1


def _warmer(images):
    gain, offset = torch.tensor([[1.0, 0.8, 0.5], [0.1, 0.0, 0.0]])[..., None, None]
    return (images * gain + offset).clamp(0, 1)


def _edited(reference, other):
    """What each view shows when `reference` and `other` are made of the object in them."""
    views = [
        OBJECT * change(image) + (1 - OBJECT) * image
        for change, image in zip((reference, other), PAIR[0])
    ]
    return torch.stack([view[0] for view in views])[None]


def _views(edited, source, matches):
    exposure = find_exposure(source, matches, matches.inside > 0)
    return EditedViews.of(edited, source, exposure, matches)


def _gap(edited, source, matches):
    return edits_disagree(_views(edited, source, matches))


def test_one_function_of_colour_in_both_views_is_no_disagreement_anywhere():
    assert (_gap(_warmer(PAIR), PAIR, SAME_PLACE) == 0).all()
    assert (_gap(_edited(_warmer, _warmer), PAIR, SAME_PLACE) == 0).all()


def test_no_edit_at_all_is_no_disagreement_where_anything_could_be_carried():
    assert not _gap(PAIR, PAIR, SAME_PLACE)[:, 0].any()


def test_another_colour_disagrees_all_over_the_object():
    gap = _gap(_edited(_warmer, lambda image: 1 - image), PAIR, SAME_PLACE)
    assert (gap[:, 1][OBJECT[:, 0] > 0] == 1).all() and not gap[:, 0].any()


def test_an_edit_of_one_view_alone_disagrees():
    unedited = lambda image: image  # noqa: E731
    for pair in ((_warmer, unedited), (unedited, _warmer)):
        assert (_gap(_edited(*pair), PAIR, SAME_PLACE)[:, 1] == 1).all()


def test_what_the_reference_shows_unedited_disagrees_although_the_function_is_the_same():
    edited = _edited(_warmer, _warmer)
    # a stripe that is edited in view 1 alone
    edited[:, 1, :, :, 38:] = _warmer(PAIR[:, 1])[..., 38:]
    gap = _gap(edited, PAIR, SAME_PLACE)[:, 1]
    assert gap[..., 40:].mean() > 0.9 and not gap[..., 14:34].any()
    assert not _gap(edited, PAIR, ELSEWHERE)[:, 1].any()


def test_what_the_view_left_unedited_where_the_reference_did_not_disagrees_too():
    edited = _edited(_warmer, _warmer)
    edited[:, 0, :, :, 38:] = _warmer(PAIR[:, 0])[..., 38:]
    gap = _gap(edited, PAIR, SAME_PLACE)[:, 1]
    assert gap[..., 40:].mean() > 0.9 and not gap[..., 14:34].any()


@pytest.mark.parametrize(
    "other",
    [lambda s: 1 - s, lambda s: s + 2 * (_warmer(s) - s)],
    ids=["another", "twice as much"],
)
def test_a_patch_that_was_edited_otherwise_disagrees_with_its_border_and_nothing_else_does(
    other,
):
    edited = _edited(_warmer, _warmer)
    patch = (slice(None), 1, slice(None), slice(14, 20), slice(16, 22))
    edited[patch] = other(PAIR[patch]).clamp(0, 1)
    gap = _gap(edited, PAIR, SAME_PLACE)[0, 1]
    assert (gap[14:20, 16:22] > 0.9).float().mean() > 0.9
    # one pixel around it, the reach at this size
    assert (gap[14:20, 15] > 0.9).all() or (gap[13, 16:22] > 0.9).all()
    away = torch.ones(SIZE, dtype=torch.bool)
    away[13:21, 15:23] = False
    assert not gap[away].any()


def _conflict(edited, matches=SAME_PLACE):
    """Where view 1 gives way, as the mean over the object and over all else."""
    views = _views(edited, PAIR, matches)
    conflict = edits_conflict(views, edits_disagree(views))
    assert not conflict[:, 0].any()
    core = -F.max_pool2d(-OBJECT[:, 0], 3, 1, 1) > 0
    away = F.max_pool2d(OBJECT[:, 0], 5, 1, 2) == 0
    return conflict[:, 1][core].mean().item(), conflict[:, 1][away].mean().item()


CONTRARY = _edited(_warmer, lambda image: 1 - image)


def test_a_view_with_a_contrary_edit_gives_way_on_the_object_alone():
    inside, away = _conflict(CONTRARY)
    assert inside > 0.95 and away == 0
    # the reference kept what the view changed
    assert _conflict(_edited(lambda image: image, _warmer))[0] > 0.95
    assert _conflict(_edited(_warmer, _warmer)) == (0, 0)


def test_an_unedited_view_keeps_its_opacity_and_one_that_was_edited_elsewhere_gives_way():
    alone = _edited(_warmer, lambda image: image)
    assert _conflict(alone) == (0, 0)
    alone[:, 1, :, :5] = 1 - PAIR[:, 1, :, :5]
    assert _conflict(alone)[0] > 0.9


def test_nothing_gives_way_where_the_reference_does_not_show_the_place():
    assert _conflict(CONTRARY, ELSEWHERE)[0] == 0
    flipped = replace(SAME_PLACE, coordinates=SAME_PLACE.coordinates.flip(3))
    behind, before = (
        replace(flipped, depth_ratio=torch.full((1, 2, *SIZE), ratio))
        for ratio in (0.3, -0.3)
    )
    assert _conflict(CONTRARY, behind)[0] < 0.5 < _conflict(CONTRARY, before)[0]


def test_a_steep_curve_is_one_function_of_colour_too():
    assert not _gap(PAIR**0.55, PAIR, SAME_PLACE).any()


def test_borders_that_mix_two_colours_of_an_edit_that_ends_at_white_are_no_disagreement():
    """Shrunk after the edit, a roof before the sky has pixels of both, and white is not twice the
    sky.
    """
    shown = torch.linspace(0.4, 0.8, 96).expand(1, 2, 3, 96, 96).clone()
    shown *= torch.tensor([0.7, 0.8, 1.0])[:, None, None]
    shown[..., 31:, :] *= 0.2
    small, edited = (
        F.interpolate(x[0], (64, 64), mode="area")[None]
        for x in (shown, (2 * shown).clamp(max=1))
    )
    places = pixel_grid((64, 64), small).expand(1, 2, -1, -1, -1)
    same = Correspondences(places, torch.ones(1, 2, 64, 64), torch.zeros(1, 2, 64, 64))
    assert not _gap(edited, small, same).any()


def test_scenes_of_a_batch_do_not_mix():
    edits = [_edited(_warmer, _warmer), _edited(_warmer, lambda image: 1 - image)]
    fields = vars(SAME_PLACE).items()
    matches = Correspondences(**{name: torch.cat((x, x)) for name, x in fields})
    together = _gap(torch.cat(edits), PAIR.expand(2, -1, -1, -1, -1), matches)
    alone = torch.cat([_gap(edit, PAIR, SAME_PLACE) for edit in edits])
    assert torch.allclose(together, alone, atol=1e-5)


DARKER = torch.tensor([0.6, 0.7, 0.8])[:, None, None]


def test_photos_of_one_exposure_have_one_look_exactly():
    none = torch.tensor([1.0, 1, 1, 0, 0, 0]).view(6, 1, 1)
    draw = torch.Generator().manual_seed(1)
    noisy = PAIR + 0.02 * torch.randn(PAIR.shape, generator=draw)
    darker = torch.cat((PAIR[:, :1], 0.5 * PAIR[:, 1:]), 1)
    cases = (PAIR, SAME_PLACE), (noisy, SAME_PLACE), (darker, ELSEWHERE)
    for photos, matches in cases:
        looks = find_exposure(photos, matches, torch.ones(1, 2, *SIZE) > 0)
        assert (looks == none).all()


def test_exposure_and_white_balance_are_read_although_a_fifth_of_the_matches_is_wrong():
    photos = torch.stack((PAIR[:, 0], DARKER * PAIR[:, 0] + 0.05), 1)
    photos[:, 1, :, :8] = 1 - photos[:, 1, :, :8]
    looks = find_exposure(photos, SAME_PLACE, torch.ones(1, 2, *SIZE) > 0)
    assert torch.equal(looks[:, 0, :, 0, 0], torch.tensor([[1.0, 1, 1, 0, 0, 0]]))
    assert torch.allclose(looks[0, 1, :3, 0, 0], DARKER[:, 0, 0], atol=0.04)
    assert torch.allclose(looks[0, 1, 3:, 0, 0], torch.tensor(0.05), atol=0.03)


def test_edits_are_compared_as_if_all_photos_had_one_exposure():
    """A function of colour can tell a darker photo from its reference, and so explain two contrary
    edits at once.
    """
    plain = 0.4 + 0.2 * PAIR
    photos = torch.cat((plain[:, :1], DARKER * plain[:, 1:]), 1)
    way = torch.tensor([1.0, -1.0, 0.5])[:, None, None]
    tint = 0.3 * way * photos * OBJECT[:, None]
    alike = photos + tint
    contrary = photos + tint * torch.tensor([1.0, -1.0])[:, None, None, None]
    assert not _gap(alike, photos, SAME_PLACE).any()
    assert (_gap(contrary, photos, SAME_PLACE)[:, 1][OBJECT[:, 0] > 0] == 1).all()


@pytest.mark.parametrize(
    "filtered",
    [lambda x: x.mean(2, keepdim=True).expand_as(x), lambda x: 0.3 + 0.5 * x],
    ids=["grey", "haze"],
)
def test_a_filter_of_photos_of_different_white_balance_is_one_function_of_colour(
    filtered,
):
    """Grey is grey in both, although the reference's grey would be brown with the other photo's
    white balance.
    """
    photos = torch.cat((PAIR[:, :1], DARKER * PAIR[:, 1:]), 1)
    assert not _gap(filtered(photos), photos, SAME_PLACE).any()


def test_one_paint_on_photos_of_different_white_balance_is_one_function_of_colour():
    photos = torch.cat((PAIR[:, :1], (0.3 * DARKER + 0.7) * PAIR[:, 1:]), 1)
    paint = torch.tensor([0.95, 0.1, 0.9])[:, None, None]
    painted = photos + OBJECT[:, None] * (paint - photos)
    assert not _gap(painted, photos, SAME_PLACE).any()
