import math

import pytest
import torch
from edit3r_training.procedural_dataset import ProceduralDataset

from edit3r.kit.geometry.cameras import project, unproject


def _dataset(**settings) -> ProceduralDataset:
    usual = {"image_size": 48, "scenes": 4, "textures": 8}
    return ProceduralDataset(ProceduralDataset.Settings(**usual | settings))


def test_surfaces_seen_by_both_views_have_the_same_colour_and_depth():
    """Warp view 0 into view 1 by the exact depth and pose: where it lands on the surface seen
    there, colours agree.
    """
    for index in range(3):
        sample = _dataset(image_size=96)[index]
        cameras, depths = sample.context_cameras, sample.context_depths
        lenses, c2w = cameras.intrinsics[0], cameras.c2w[0]
        points = unproject(depths[:1], lenses[:1], c2w[:1]).reshape(1, -1, 3)
        places, z = project(points, lenses[1:], c2w[1:])
        grid = (places * 2 - 1).reshape(1, 96, 96, 2)
        seen = torch.cat((sample.context[1], depths[1:]))[None]
        pulled = torch.nn.functional.grid_sample(seen, grid, align_corners=False)[0]
        visible = (grid[0].abs() < 0.98).all(-1)
        visible &= (pulled[3] / z.reshape(96, 96)).log().abs() < 0.01
        assert visible.float().mean() > 0.3
        gap = (pulled[:3] - sample.context[0]).abs().mean(0)[visible]
        assert gap.median() < 0.03


def test_angles_between_views_are_within_the_range():
    data = _dataset(angles=(10, 12), image_size=8)
    for index in range(4):
        forward = data[index].context_cameras.c2w[0, :, :3, 2]
        angle = math.degrees(math.acos(float(forward[0] @ forward[1])))
        assert 7 < angle < 16


def test_masks_cover_every_pixel_once():
    sample = _dataset()[0]
    assert torch.allclose(sample.context_masks.sum(0), torch.ones(2, 48, 48), atol=0.02)


def test_recoloring_changes_one_object_and_nothing_else():
    sample = _dataset(edit="recolor")[1]
    # [view, height, width]
    change = (sample.edited_context - sample.context).abs().amax(1)
    inside = [(change * mask).sum() / change.sum() for mask in sample.context_masks]
    edited = max(range(len(inside)), key=lambda i: inside[i])
    assert change[sample.context_masks[edited] == 0].max() < 0.01
    assert change[sample.context_masks[edited] > 0.9].mean() > 0.03


def test_removing_reveals_what_was_behind():
    sample = _dataset(edit="remove")[2]
    changed = (sample.edited_context - sample.context).abs().amax(1) > 0.02
    assert 0.005 < changed[0].float().mean() < 0.9


def test_views_beyond_two_are_made_too():
    sample = _dataset(context=4, targets=3, image_size=16)[0]
    assert sample.context.shape == (4, 3, 16, 16)
    assert sample.target.shape == (3, 3, 16, 16)
    assert sample.target_masks.shape[:2] == (sample.context_masks.shape[0], 3)


def test_kept_samples_are_the_same_as_fresh_ones():
    kept = _dataset(keep=True)
    first, again = kept[1], kept[1]
    assert torch.equal(first.context, again.context)
    assert torch.equal(first.context, _dataset()[1].context)


def test_two_seeds_share_no_scene():
    assert not torch.equal(_dataset(seed=1)[0].context, _dataset(seed=2)[0].context)


@pytest.mark.parametrize("key", [{"image_size": 4}, {"context": 0}, {"edit": "melt"}])
def test_settings_out_of_range_are_refused(key):
    with pytest.raises(ValueError):
        _dataset(**key)


def test_shape_draws_things_added_and_removed_for_every_scene():
    def edited(edit, index):
        small = {"image_size": 16, "scenes": 12, "seed": 4, "edit_seed": 1}
        return _dataset(**small, edit=edit)[index]

    kinds = []
    for index in range(12):
        shape = edited("shape", index)
        alone = {kind: edited(kind, index) for kind in ("add", "remove")}
        # The unedited scene of `add` lacks its last object, that of `remove` has them all.
        same = next(k for k in alone if torch.equal(alone[k].context, shape.context))
        kinds.append(same)
        assert torch.equal(shape.context_depths, alone[same].context_depths)
    assert {*kinds} == {"add", "remove"}
