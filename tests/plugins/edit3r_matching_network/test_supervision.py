from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from edit3r_matching_network.network import MatchingNetwork
from edit3r_matching_network.supervision import coarser, geometry_terms, match_error, rotation_errors, true_pairs
from edit3r_matching_network.training_pairs import Augmentation, PairMemory, TrainingPairs, augmented

from edit3r.errors import InputError
from edit3r.interfaces import Dataset
from edit3r.registry import build
from edit3r.testing import photograph


@pytest.fixture(scope="module")
def batch() -> TrainingPairs:
    scene = photograph(2, (32, 48), batch=2)
    return TrainingPairs(scene.views.images, scene.views.intrinsics, scene.cameras.c2w, scene.depths)


@pytest.fixture(scope="module")
def prediction(batch):
    torch.manual_seed(0)
    return MatchingNetwork(width=32, fine_width=16, heads=2)(batch.images, batch.intrinsics)


def _colour_error(batch: TrainingPairs) -> tuple[float, float]:
    """Median difference of colours between true matches, and between the same coordinates."""
    truth = true_pairs(batch)
    small = F.avg_pool2d(batch.images.flatten(0, 1), 2).unflatten(0, batch.images.shape[:2])
    there = F.grid_sample(small.flip(1).flatten(0, 1), truth.coordinates.flatten(0, 1) * 2 - 1, align_corners=False)
    matched = (there.unflatten(0, small.shape[:2]) - small).abs().mean(2)[truth.visible].median()
    return float(matched), float((small - small.flip(1)).abs().mean(2)[truth.visible].median())


def test_true_matches_show_the_same_colour():
    scene = photograph(2, (96, 128))
    large = TrainingPairs(scene.views.images, scene.views.intrinsics, scene.cameras.c2w, scene.depths)
    matched, same_place = _colour_error(large)
    assert matched < 0.3 * same_place
    assert true_pairs(large).visible.float().mean() > 0.5


def test_the_true_answer_has_no_error(batch, prediction):
    truth = true_pairs(batch)
    right = replace(
        prediction,
        coordinates=truth.coordinates,
        log_depths=truth.log_depths + 0.3,
        confidence_logits=torch.where(truth.visible, 20.0, -20.0),
    )
    terms = geometry_terms(right, batch)
    assert terms["match"] < 2e-3 and terms["depth"] < 1e-5 and terms["confidence"] < 1e-5
    assert terms["rotation"] < 0.02 and terms["translation"] < 0.1
    assert (rotation_errors(right, batch) < 1).all()
    assert torch.isclose(terms["unit"], torch.tensor(0.3), atol=1e-4)


def test_every_term_is_finite_and_reaches_the_network(batch):
    torch.manual_seed(0)
    network = MatchingNetwork(width=32, fine_width=16, heads=2)
    torch.nn.init.normal_(network.decoder.out.weight, std=0.1)
    terms = geometry_terms(network(batch.images, batch.intrinsics), batch)
    del terms["translation"]  # at its ceiling for a random network, where it does not pull
    for name, term in terms.items():
        network.zero_grad()
        term.backward(retain_graph=True)
        norms = [p.grad.norm() for p in network.parameters() if p.grad is not None]
        assert torch.isfinite(term) and sum(norms) > 0 and all(torch.isfinite(n) for n in norms), name


def test_coarse_places_are_those_of_the_cells_they_hold(batch):
    fine = true_pairs(batch)
    coarse = coarser(fine)
    assert coarse.coordinates.shape[2:4] == (8, 12)
    mean = F.avg_pool2d(fine.coordinates.movedim(-1, 2).flatten(0, 1), 2).unflatten(0, (2, 2))
    every = F.avg_pool2d(fine.visible.float(), 2) == 1
    assert torch.allclose(
        coarse.coordinates[coarse.visible & every], mean.movedim(2, -1)[coarse.visible & every], atol=1e-5
    )


@pytest.mark.parametrize("seed", range(6))
def test_augmented_scenes_stay_true(batch, seed):
    """Truth that no longer fitted the pictures would show up as colours that differ between matches."""
    changed = augmented(batch, Augmentation(exposure=0, noise=0, narrow=0.5), np.random.default_rng(seed))
    (before, _), (after, same_place) = _colour_error(batch), _colour_error(changed)
    assert after < 1.3 * before and after < 0.7 * same_place
    assert abs(true_pairs(changed).visible.float().mean() - true_pairs(batch).visible.float().mean()) < 0.15
    assert torch.equal(changed.c2w[:, 0], torch.eye(4).expand(2, 4, 4))


def test_matches_far_off_are_measured_in_cells(batch):
    truth = true_pairs(batch)
    moved = truth.coordinates + torch.tensor([2 / 24, 0.0])
    assert torch.allclose(match_error(moved, truth), torch.full(truth.visible.shape, 2.0), atol=1e-3)


def test_scenes_are_kept_within_eight_bits_and_half_precision():
    data = build("dataset", "procedural", image_size=32, textures=8, scenes=3, targets=0)
    memory = PairMemory(data)
    first, again = memory.batch([1]), memory.batch([1])
    assert torch.equal(first.images, again.images)
    assert (first.images - data[1].context).abs().max() <= 0.5 / 255 + 1e-6
    assert torch.allclose(first.depths[0], data[1].context_depths, rtol=1e-3)


def test_data_without_depths_is_refused_by_name():
    class Blind(Dataset):
        def __len__(self):
            return 1

        def __getitem__(self, index):
            sample = build("dataset", "procedural", image_size=32, textures=8, scenes=1, targets=0)[0]
            return replace(sample, context_depths=None, name="blind-0")

    with pytest.raises(InputError, match=r"'blind-0'.*with depths"):
        PairMemory(Blind()).batch([0])
