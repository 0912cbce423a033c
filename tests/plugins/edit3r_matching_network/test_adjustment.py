from dataclasses import replace

import torch
from edit3r_matching_network.adjustment import Evidence, adjust, best_of, evidence_of, start_at

from edit3r.geometry.cameras import intrinsics_from_fov, project, unproject
from edit3r.geometry.rotations import cross_matrix, rotation_angle

GRID = (12, 16)
INTRINSICS = intrinsics_from_fov(1.0, GRID).expand(1, 2, 3, 3)


def _scene(seed=0):
    """True pose, depths and matches of a bumpy scene; every cell matches, even beyond the picture."""
    random = torch.Generator().manual_seed(seed)
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, :3, :3] = torch.linalg.matrix_exp(cross_matrix(torch.tensor([0.05, -0.2, 0.03])))
    c2w[0, 1, :3, 3] = torch.tensor([0.6, 0.1, 0.05])
    depths = 2 + torch.rand(1, 2, *GRID, generator=random) * 2
    points = unproject(depths, INTRINSICS, c2w).flatten(2, 3)
    places, _ = project(points, INTRINSICS.flip(1), c2w.flip(1))
    return c2w, depths, places.reshape(1, 2, *GRID, 2)


def _evidence(places, depths, weight=1.0, spread=0.3) -> Evidence:
    ones = torch.ones(1, 2, *GRID)
    return evidence_of(places, weight * ones, depths.log(), spread * ones, INTRINSICS)


def _wrong_start(evidence: Evidence, c2w, angle=0.15):
    turn = torch.linalg.matrix_exp(cross_matrix(torch.full((1, 3), angle / 3**0.5)))
    return start_at(evidence, turn @ c2w[:, 1, :3, :3], c2w[:, 1, :3, 3] * 1.4, torch.ones(1))


def test_true_matches_and_depths_give_the_true_pose():
    c2w, depths, places = _scene()
    evidence = _evidence(places, depths)
    found = adjust(evidence, _wrong_start(evidence, c2w)).estimate
    assert rotation_angle(found.rotation, c2w[:, 1, :3, :3].double()) < 1e-4
    assert torch.allclose(found.translation, c2w[:, 1, :3, 3].double(), atol=1e-3)


def test_a_view_whose_depths_are_too_large_is_brought_to_scale():
    c2w, depths, places = _scene()
    larger = depths * torch.tensor([1.0, 1.6])[:, None, None]
    evidence = _evidence(places, larger)
    found = adjust(evidence, _wrong_start(evidence, c2w)).estimate
    assert torch.allclose(found.log_scale.exp(), torch.tensor([1 / 1.6]).double(), atol=0.02)
    assert torch.allclose(found.log_depths[:, 1].exp().float(), depths[:, 1].flatten(1), rtol=0.02)


def test_wrong_depths_are_mended_by_matches_and_the_pose_hardly_suffers():
    c2w, depths, places = _scene()
    noise = 0.2 * torch.randn(depths.shape, generator=torch.Generator().manual_seed(1))
    evidence = _evidence(places, depths * noise.exp())
    found = adjust(evidence, _wrong_start(evidence, c2w)).estimate
    error = (found.log_depths.float() - depths.log().flatten(2)).flatten(1)
    error = error - error.median()
    assert rotation_angle(found.rotation, c2w[:, 1, :3, :3].double()) < 0.02
    assert error.abs().mean() < 0.35 * noise.abs().mean()


def test_a_quarter_of_wrong_matches_is_ignored():
    c2w, depths, places = _scene()
    random = torch.Generator().manual_seed(2)
    wrong = torch.rand(1, 2, *GRID, generator=random) < 0.25
    spoiled = torch.where(wrong[..., None], torch.rand(places.shape, generator=random), places)
    evidence = _evidence(spoiled, depths, spread=0.1)
    adjusted = adjust(evidence, _wrong_start(evidence, c2w))
    assert rotation_angle(adjusted.estimate.rotation, c2w[:, 1, :3, :3].double()) < 0.01
    assert (
        adjusted.residuals.reshape(wrong.shape)[wrong].median()
        > 1
        > adjusted.residuals.reshape(wrong.shape)[~wrong].max()
    )


def test_without_matches_everything_stays_where_it_was():
    c2w, depths, places = _scene()
    evidence = _evidence(places, depths, weight=0.0)
    start = _wrong_start(evidence, c2w)
    found = adjust(evidence, start).estimate
    assert torch.allclose(found.rotation, start.rotation, atol=1e-6)
    assert torch.allclose(found.log_depths, start.log_depths, atol=1e-6)


def test_scenes_of_a_batch_do_not_disturb_each_other():
    c2w, depths, places = _scene()
    evidence = _evidence(places, depths)
    start = _wrong_start(evidence, c2w)
    hopeless = replace(
        evidence, seen=torch.rand(evidence.seen.shape, generator=torch.Generator().manual_seed(3)).double()
    )
    both = Evidence(*(torch.cat((a, b)) for a, b in zip(vars(evidence).values(), vars(hopeless).values())))
    starts = type(start)(*(torch.cat((x, x)) for x in vars(start).values()))
    alone, together = adjust(evidence, start).estimate, adjust(both, starts).estimate
    assert torch.allclose(alone.rotation, together.rotation[:1], atol=1e-9)
    assert all(torch.isfinite(x).all() for x in vars(together).values())


def test_the_pose_step_is_downhill_along_the_derivative():
    """The linear model's prediction of a tiny turn's effect on the residuals, against the residuals after it."""
    from edit3r_matching_network.adjustment import _linearise

    c2w, depths, places = _scene()
    evidence = _evidence(places, depths)
    start = _wrong_start(evidence, c2w, angle=0.02)
    before = _linearise(evidence, start, 0.25)
    step = 1e-5
    for axis in range(3):
        turn = torch.linalg.matrix_exp(cross_matrix(step * torch.eye(3)[axis].double()))
        after = _linearise(evidence, replace(start, rotation=start.rotation @ turn), 0.25)
        # The vector is the gradient of half the robust cost, see `_robust`.
        assert torch.isclose((after.cost - before.cost) / step / 2, before.pose_vector[:, axis], rtol=1e-2)


def test_the_cheapest_of_several_starts_is_kept_for_each_scene():
    c2w, depths, places = _scene()
    evidence = _evidence(places, depths)
    good, bad = _wrong_start(evidence, c2w, angle=0.05), _wrong_start(evidence, c2w, angle=3.0)
    both = Evidence(*(value.repeat_interleave(2, 0) for value in vars(evidence).values()))
    starts = type(good)(*(torch.cat(pair) for pair in zip(vars(bad).values(), vars(good).values())))
    candidates = adjust(both, starts)
    best = best_of(candidates, 2)
    assert best.cost == candidates.cost.min()
    assert rotation_angle(best.estimate.rotation, c2w[:, 1, :3, :3].double()) < 1e-3
