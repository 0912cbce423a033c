"""What is taken away shows what another view sees behind it."""

from dataclasses import replace

import pytest
import torch
from edit3r_editors.retouch import (
    RetouchEditor,
    _invented,
    inpainted,
    spanned,
    standing_on,
)

import edit3r
from edit3r.contract.errors import InputError, MatchingError
from edit3r.contract.interfaces import Geometry, Matcher, Reconstructor
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.kit.geometry.maps import dilate

SIZE, WALL, BOARD, STEP = 64, 4.0, 2.0, 0.5
"""A striped wall, a board before it, and a second camera that stands to the right of the first."""


def _scene() -> tuple[Views, torch.Tensor, torch.Tensor, Geometry]:
    """Two views of wall and board, the same without the board, where the board is, and the true
    geometry.
    """
    k = intrinsics_from_fov(1.0, (SIZE, SIZE))
    column = (torch.arange(SIZE) + 0.5) / SIZE
    images, empty, masks, depths = [], [], [], []
    for view in range(2):
        x = WALL * (column - k[0, 2]) / k[0, 0] + STEP * view  # of the wall's points
        wall = torch.stack(
            [0.5 + 0.4 * torch.sin(speed * x) for speed in (3.0, 5.0, 7.0)]
        )
        board = (BOARD * (column - k[0, 2]) / k[0, 0] + STEP * view).abs() < 0.1
        picture = torch.where(board, torch.tensor([[1.0], [0.0], [0.0]]), wall)
        grid = (SIZE, SIZE)
        images.append(picture[:, None].expand(3, *grid))
        empty.append(wall[:, None].expand(3, *grid))
        masks.append(board.float().expand(grid))
        depths.append(torch.where(board, BOARD, WALL).expand(grid))
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = STEP
    depths = torch.stack(depths)[None]
    geometry = Geometry(
        c2w, depths, torch.ones_like(depths), torch.ones(1, 2, dtype=torch.bool)
    )
    views = Views(torch.stack(images)[None], k.expand(1, 2, 3, 3), ("left", "right"))
    return views, torch.stack(empty), torch.stack(masks)[None], geometry


class _Known(Matcher):
    def __init__(self, geometry: Geometry | None) -> None:
        self.geometry = geometry

    def match(self, views: Views) -> Geometry:
        if self.geometry is None:
            raise MatchingError("too few matches.")
        return self.geometry


def _retouched(
    geometry: Geometry | None, views: Views, masks: torch.Tensor
) -> tuple[torch.Tensor, Report]:
    editor = RetouchEditor(RetouchEditor.Settings(), _Known(geometry))
    with collecting(Report()) as report:
        return editor.edit(views, EditRequest("", 0, masks)).images[0], report


def _error(image: torch.Tensor, truth: torch.Tensor, masks: torch.Tensor) -> float:
    return float((image - truth).abs().mean(1)[masks[0] > 0].mean())


def test_the_hole_shows_what_the_other_view_sees_and_not_what_surrounds_it():
    views, truth, masks, geometry = _scene()
    carried, report = _retouched(geometry, views, masks)
    alone, _ = _retouched(None, views, masks)
    assert _error(carried, truth, masks) < 0.02 < 0.05 < _error(alone, truth, masks)
    assert min(report.notes["retouch.seen_by_other_photos"]) > 0.8


def test_depths_that_were_filled_in_around_the_object_do_not_move_what_is_behind():
    """Where nothing was measured, a matcher's depth runs from the board into the wall: it must not
    be carried.
    """
    views, truth, masks, geometry = _scene()
    beside = torch.nn.functional.max_pool2d(masks, (1, 13), 1, (0, 6)) > 0
    smeared = replace(
        geometry,
        depths=torch.where(beside, BOARD, geometry.depths),
        confidence=torch.where(beside, 0.0, geometry.confidence),
    )
    carried, report = _retouched(smeared, views, masks)
    assert (
        _error(carried, truth, masks) < 0.02
        and min(report.notes["retouch.seen_by_other_photos"]) > 0.8
    )


def test_what_one_of_three_photos_shows_against_its_own_depth_is_not_believed():
    views, _, masks, geometry = _scene()
    far = 6 * STEP  # the third view does not see what is behind the board
    c2w = torch.cat((geometry.c2w, torch.eye(4)[None, None]), 1)
    c2w[0, 2, 0, 3] = far
    depths = torch.cat(
        (geometry.depths, torch.full_like(geometry.depths[:, :1], WALL)), 1
    )
    blind = Views(
        torch.cat((views.images, torch.zeros_like(views.images[:, :1])), 1),
        views.intrinsics[:, :1].expand(1, 3, 3, 3),
    )
    masks = torch.cat((masks, torch.zeros_like(masks[:, :1])), 1)
    known = Geometry(
        c2w, depths, torch.ones_like(depths), torch.ones(1, 3, dtype=torch.bool)
    )
    doubtful = replace(
        known, depths=depths.clone(), confidence=known.confidence.clone()
    )
    doubtful.depths[:, 1:], doubtful.confidence[:, 1:] = 1.5 * WALL, 0
    right = _retouched(known, blind, masks)[1].notes["retouch.seen_by_other_photos"][0]
    wrong = _retouched(doubtful, blind, masks)[1].notes["retouch.seen_by_other_photos"][
        0
    ]
    assert right > 0.8 and wrong < 0.2


def test_a_photo_that_shows_something_else_beside_the_hole_lends_nothing():
    """A wrong pose is noticed there: what it would carry into the hole is wrong as well."""
    views, _, masks, geometry = _scene()
    wrong = geometry.c2w.clone()
    wrong[0, 1, 0, 3] += 0.2
    _, report = _retouched(replace(geometry, c2w=wrong), views, masks)
    assert report.notes["retouch.seen_by_other_photos"] == [0.0, 0.0]


def test_the_surface_behind_a_hole_continues_the_plane_around_it():
    y, x = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    plane = 0.2 + 0.004 * x + 0.002 * y
    hole = (x - 30).abs().lt(9) & (y - 22).abs().lt(12)
    found = spanned(torch.where(hole, 0, plane)).numpy()
    assert abs(found - plane.numpy()).max() < 0.01 * plane.max()


def test_what_is_invented_has_no_streak_of_a_thing_that_touches_the_hole():
    """A paper's corner beside a magazine on a table."""
    table = torch.full((3, SIZE, SIZE), 0.4)
    hole = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    hole[20:44, 20:44] = True
    table[:, 16:20, 30:34] = 1.0
    filled = inpainted(table, hole)
    assert torch.equal(filled[:, ~hole], table[:, ~hole])
    assert filled[:, 28:44, 20:44].max() < 0.5


@pytest.mark.parametrize("longer", [96, 320])
def test_a_hole_in_a_pattern_goes_on_with_the_pattern(longer):
    """Those too that are filled at a smaller size."""
    x = torch.arange(longer) * 60.0 / longer
    stripes = (0.5 + 0.15 * torch.sin(x)).expand(3, longer, longer)
    hole = torch.zeros(longer, longer, dtype=torch.bool)
    middle = slice(longer // 4, 3 * longer // 4)
    hole[middle, middle] = True
    filled = inpainted(torch.where(hole, 0.0, stripes), hole)
    assert filled.min() >= 0 and filled.max() <= 1
    assert (filled - stripes)[:, hole].abs().mean() < 0.05 < stripes.std() / 2


def test_a_thing_beside_a_hole_is_not_copied_into_it():
    """Red lids in rows on a table, and a hole where one of them stood."""
    table = 0.5 + 0.1 * torch.rand(3, 128, 128, generator=torch.manual_seed(0))
    y, x = torch.meshgrid(torch.arange(128), torch.arange(128), indexing="ij")
    lids = ((x % 32 - 16).abs() > 10) & ((y % 32 - 16).abs() > 10)
    table[:, lids] = torch.tensor([[0.9], [0.05], [0.05]])
    hole = ((x - 64).abs() < 20) & ((y - 64).abs() < 20)
    filled = inpainted(torch.where(hole, 0.0, table), hole)[:, hole]
    assert (filled[0] - filled[1]).max() < 0.25


def test_what_no_photo_sees_is_invented_once_for_all_photos():
    """A wide board: what is behind it, on the wall, is the same in both photos."""
    views, _, _, geometry = _scene()
    depths, unseen = torch.full((2, SIZE, SIZE), WALL), torch.zeros(2, SIZE, SIZE) > 0
    shift = 8  # pixels by which the second photo sees the wall aside
    unseen[0, 20:44, 24:48] = True
    unseen[1, 20:44, 24 - shift : 48 - shift] = True
    lenses, poses = views.intrinsics[0], geometry.c2w[0].clone()
    poses[1, 0, 3] = shift * WALL / (SIZE * lenses[0, 0, 0])
    first, second = _invented(
        views.images[0], unseen, depths, (True, True), lenses, poses
    )
    assert (first[:, unseen[0]] != views.images[0, 0][:, unseen[0]]).any()
    apart = first[:, 20:44, 24:48] - second[:, 20:44, 24 - shift : 48 - shift]
    assert apart.abs().mean() < 0.02
    alone = _invented(views.images[0], unseen, depths, (True, False), lenses, poses)
    apart = alone[0, :, 20:44, 24:48] - alone[1, :, 20:44, 24 - shift : 48 - shift]
    assert apart.abs().mean() > 0.04


def test_a_photo_without_any_measured_depth_is_still_filled():
    views, _, masks, geometry = _scene()
    image, _ = _retouched(
        replace(geometry, confidence=torch.zeros_like(geometry.confidence)),
        views,
        masks,
    )
    assert torch.isfinite(image).all() and torch.equal(
        image[:, 0][masks[0] == 0], views.images[0, :, 0][masks[0] == 0]
    )


def test_what_no_other_view_sees_is_invented_and_said():
    views, _, masks, geometry = _scene()
    apart = replace(geometry, registered=torch.tensor([[True, False]]))
    image, report = _retouched(apart, views, masks)
    assert (
        report.notes["retouch.seen_by_other_photos"] == [0, 0]
        and "invented" in report.warnings[0]
    )
    assert (
        torch.isfinite(image).all()
        and (image != views.images[0]).any(1)[masks[0] > 0].float().mean() > 0.9
    )


def test_the_run_reconstructs_what_is_left_from_the_edited_photos():
    seen = []

    class Spy(Reconstructor):
        def __call__(self, views, source=None, geometry=None, grid=None):
            seen.append(source)
            raise MatchingError("enough.")

    views, truth, masks, geometry = _scene()
    editor = RetouchEditor(RetouchEditor.Settings(), _Known(geometry))
    with pytest.raises(MatchingError):
        edit3r.run(views, masks=masks, editor=editor, recon=Spy())
    assert _error(seen[0].images[0], truth, masks) < 0.02
    with pytest.raises(InputError, match="which object is meant"):
        edit3r.run(views, editor=editor, recon=Spy())


def _ball_on_the_ground() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """An image of a red ball on grey ground with its shadow, the ball's mask, and the shadow's."""
    row, column = torch.meshgrid(torch.arange(96), torch.arange(96), indexing="ij")
    ball = (row - 40) ** 2 + (column - 48) ** 2 < 15**2
    shadow = ((row - 55) / 4) ** 2 + ((column - 48) / 14) ** 2 < 1
    light = torch.where(shadow, 0.35, 0.7) + 0.02 * torch.sin(0.9 * column)
    image = light.expand(3, 96, 96).clone()
    image[:, ball] = torch.tensor([0.8, 0.1, 0.1])[:, None]
    return image, ball, shadow & ~ball


def test_rim_and_shadow_of_the_thing_are_removed_with_it():
    image, ball, shadow = _ball_on_the_ground()
    tight = -dilate(-ball.float()[None], 1)
    editor = RetouchEditor(RetouchEditor.Settings(shadow=0.1), _Known(None))
    views = Views(image[None, None], torch.eye(3).expand(1, 1, 3, 3))
    wide = editor.widened(tight[None, None], views.images)[0]
    assert wide[0, 0][ball].all()
    assert wide[0, 0][shadow].mean() > 0.95
    assert wide[0, 0].sum() < 1.4 * (ball | shadow).sum()
    removed = editor.edit(views, EditRequest("", 0, wide)).images[0, 0]
    removed = torch.where(wide[0, 0] > 0, removed, image)
    assert (removed - 0.7).abs().max() < 0.15


def test_what_is_dark_by_its_own_colour_is_no_shadow():
    image, ball, shadow = _ball_on_the_ground()
    image[:, shadow] = torch.tensor([0.6, 0.3, 0.1])[:, None]
    settings = RetouchEditor.Settings(rim=0, shadow=0.1)
    wide = RetouchEditor(settings, _Known(None)).widened(
        ball.float()[None, None, None], image[None, None]
    )
    assert not wide[0, 0, 0][shadow].any()


def _vase(depth_of_flowers: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A vase on a table before a wall, flowers above it: the vase, the flowers, depths."""
    rows, columns = torch.meshgrid(*[torch.arange(SIZE)] * 2, indexing="ij")
    middle = (columns - SIZE // 2).abs()
    vase = (rows >= 32) & (rows < 52) & (middle < 6)
    flowers = (rows >= 16) & (rows < 32) & (middle < 8)
    depth = torch.full((SIZE, SIZE), WALL)
    table = rows >= 40
    depth[table] = (WALL - 0.1 * (rows - 32))[table]
    depth[vase], depth[flowers] = BOARD, depth_of_flowers
    return vase, flowers, depth


def test_flowers_that_stand_in_a_removed_vase_are_known_to_be_left():
    vase, flowers, depth = _vase(BOARD)
    assert torch.equal(standing_on(vase, depth), flowers)


def test_what_hangs_on_the_wall_behind_is_not_taken_for_left():
    vase, _, depth = _vase(WALL)
    assert not standing_on(vase, depth).any()


def test_a_table_around_a_flat_thing_does_not_stand_on_it():
    flat = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    flat[30:40, 20:44] = True
    depth = (3 - 0.01 * torch.arange(SIZE, dtype=torch.float32))[:, None].expand(
        SIZE, SIZE
    )
    assert not standing_on(flat, depth).any()


def test_what_is_left_of_what_is_removed_is_said():
    views, _, masks, geometry = _scene()
    vase, _, depth = _vase(BOARD)
    holes = vase.float().expand_as(masks)
    known = replace(geometry, depths=depth.expand_as(geometry.depths))
    _, report = _retouched(known, views, holes)
    assert any("seems to be left" in text for text in report.warnings)
