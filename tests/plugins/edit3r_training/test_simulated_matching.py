import numpy as np
import torch
from edit3r_training.procedural_dataset import ProceduralDataset
from edit3r_training.simulated_matching import seen_by_partner, simulate_match

from edit3r.kit.geometry.rotations import rotation_angle

DATA = ProceduralDataset(ProceduralDataset.Settings(image_size=48, scenes=4))


def _matches(count: int = 12):
    samples = [DATA[index % 4] for index in range(count)]
    draws = map(np.random.default_rng, range(count))
    return [(one, simulate_match(one, draw)) for one, draw in zip(samples, draws)]


def test_measured_depth_is_nearly_right_and_filled_in_depth_less_so():
    measured, filled = [], []
    for sample, match in _matches():
        true = sample.context_depths * match.unit
        gap = (match.geometry.depths[0] / true).log().abs()
        sure = match.geometry.confidence[0] > 0.5
        measured.append(float(gap[sure].median()))
        filled.append(float(gap[~sure].mean()))
    assert np.median(measured) < 0.04
    assert np.mean(filled) > 2 * np.mean(measured)


def test_poses_are_off_by_tenths_of_a_degree():
    errors = []
    for sample, match in _matches():
        assert torch.equal(match.geometry.c2w[0, 0], torch.eye(4))
        poses = match.geometry.c2w, sample.context_cameras.c2w
        error = rotation_angle(*(c2w[0, 1, :3, :3] for c2w in poses))
        errors.append(float(torch.rad2deg(error)))
    assert 0.02 < np.median(errors) < 1


def test_unit_of_length_is_common_to_depths_and_poses():
    for sample, match in _matches(4):
        poses = match.geometry.c2w, sample.context_cameras.c2w
        found, true = (float(c2w[0, 1, :3, 3].norm()) for c2w in poses)
        assert np.isclose(found / true, match.unit, rtol=1e-4)


def test_same_random_numbers_give_the_same_match():
    first, second = (
        simulate_match(DATA[0], np.random.default_rng(5)).geometry for _ in range(2)
    )
    assert torch.equal(first.depths, second.depths)
    assert torch.equal(first.c2w, second.c2w)


def test_a_wall_facing_two_cameras_side_by_side_is_seen_by_both_where_pictures_overlap():
    c2w = torch.eye(4).repeat(2, 1, 1)
    c2w[1, 0, 3] = 0.5  # half a picture at distance 1 with focal length 1
    k = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).repeat(2, 1, 1)
    seen = seen_by_partner(torch.ones(2, 16, 16), c2w, k)
    assert not seen[0, :, :8].any() and seen[0, :, 8:].all()
    assert seen[1, :, :8].all() and not seen[1, :, 8:].any()
