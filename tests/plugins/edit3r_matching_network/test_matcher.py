import pytest
import torch
from edit3r_matching_network.matcher import NetworkMatcher, network_size
from edit3r_matching_network.network import MatchingNetwork, PairPrediction
from edit3r_matching_network.pair_geometry import FARTHEST, _completed, pair_geometry
from edit3r_matching_network.supervision import true_pairs
from edit3r_matching_network.training_pairs import TrainingPairs
from edit3r_matching_network.two_view_adjustment import evidence_of
from torch import nn

from edit3r.errors import MatchingError
from edit3r.geometry.rotations import rotation_angle
from edit3r.reporting import Report, collecting
from edit3r.testing import photograph
from edit3r.types import Views

SIZE = (48, 64)
SCENE = photograph(3, SIZE)


class _Oracle(nn.Module):
    """In place of the network: true matches and depths of SCENE, depths in a unit of its own for every pair."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(1))
        self.calls = 0

    def forward(self, images: torch.Tensor, intrinsics: torch.Tensor) -> PairPrediction:
        self.calls += 1
        views = [0, self.calls]
        c2w = SCENE.cameras.c2w[:, views]
        truth = true_pairs(TrainingPairs(images, intrinsics, c2w, SCENE.depths[:, views]))
        unit = 0.5 * self.calls
        return PairPrediction(
            None,
            None,
            None,
            truth.coordinates,
            torch.where(truth.visible, 6.0, -6.0),
            truth.log_depths + unit,
            torch.full_like(truth.log_depths, -2.0),
        )


@pytest.fixture
def matcher() -> NetworkMatcher:
    made = NetworkMatcher(NetworkMatcher.Settings(weights="untrained"))
    made.matching_network = _Oracle()
    return made


def _ratio_spread(found, true):
    ratio = (found / true).log()
    return float((ratio - ratio.median()).abs().mean())


def test_true_predictions_give_true_poses_and_depths_in_one_unit(matcher):
    geometry = matcher.match(SCENE.views)
    unit = (geometry.depths / SCENE.depths).median()
    for view in (1, 2):
        found, true = geometry.c2w[0, view], SCENE.cameras.c2w[0, view]
        assert rotation_angle(found[:3, :3], true[:3, :3]) < 0.01
        assert torch.allclose(found[:3, 3] / unit, true[:3, 3], atol=0.03)
    assert _ratio_spread(geometry.depths, SCENE.depths) < 0.05
    assert geometry.registered.all()


def test_view_0_is_the_origin(matcher):
    assert torch.equal(matcher.match(SCENE.views).c2w[0, 0], torch.eye(4))


def test_a_flat_photo_is_left_out_and_named(matcher):
    images = SCENE.views.images.clone()
    images[:, 2] = 0.5
    report = Report()
    with collecting(report):
        geometry = matcher.match(Views(images, SCENE.views.intrinsics, ("a", "b", "c")))
    assert geometry.registered.tolist() == [[True, True, False]]
    assert any(warning.startswith("c: ") for warning in report.warnings)


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_photos_without_texture_cannot_be_matched(matcher, value):
    with pytest.raises(MatchingError, match="use matcher classical"):
        matcher.match(Views(torch.full_like(SCENE.views.images, value), SCENE.views.intrinsics))


def test_one_photo_and_tiny_photos_are_refused(matcher):
    with pytest.raises(MatchingError, match="at least two photos"):
        matcher.match(SCENE.views.select([0]))
    with pytest.raises(MatchingError, match="8 x 6 pixels"):
        matcher.match(Views(SCENE.views.images[..., :6, :8], SCENE.views.intrinsics))


@pytest.mark.parametrize("kind", ["same twice", "noise", "black and photo"])
def test_a_network_that_knows_nothing_still_gives_finite_geometry(kind):
    matcher = NetworkMatcher(NetworkMatcher.Settings(weights="untrained", least_matched=0))
    images = SCENE.views.images[:, :2].clone()
    if kind == "same twice":
        images[:, 1] = images[:, 0]
    if kind == "noise":
        images = torch.rand(images.shape, generator=torch.Generator().manual_seed(0))
    if kind == "black and photo":
        images[:, 1, :, ::2] = 0
    geometry = matcher.match(Views(images, SCENE.views.intrinsics[:, :2]))
    assert all(torch.isfinite(x).all() for x in (geometry.c2w, geometry.depths, geometry.confidence))
    assert (geometry.depths > 0).all()


def test_without_adjustment_the_pose_is_procrustes_and_depths_are_as_predicted(matcher):
    small = SCENE.views.select([0, 1])
    prediction = matcher.matching_network(small.images, small.intrinsics)
    plain = pair_geometry(prediction, small.intrinsics, small.images, adjusting=False)
    assert torch.allclose(plain.depths[:, 0], prediction.log_depths[:, 0].exp(), rtol=1e-5)
    assert rotation_angle(plain.c2w[0, :3, :3], SCENE.cameras.c2w[0, 1, :3, :3]) < 0.02


def test_completion_stays_near_the_prediction_however_uneven_the_information():
    random = torch.Generator().manual_seed(0)
    prior = torch.rand(1, 2, 24, 32, generator=random)
    found = prior + torch.randn(prior.shape, generator=random) * 40
    information = 10 ** (torch.rand(prior.shape, generator=random, dtype=torch.float64) * 20 - 10)
    completed = _completed(prior.double(), found.double(), information, SCENE.views.images[:, :2])
    assert (completed - prior).abs().max() <= FARTHEST + 1e-6


def test_completion_carries_corrections_to_where_nothing_matched():
    prior = torch.zeros(1, 2, 24, 32, dtype=torch.float64)
    information = torch.zeros_like(prior)
    information[..., ::4, ::4] = 1e4
    found = torch.where(information > 0, 0.3, 0.0)
    completed = _completed(prior, found, information, torch.full((1, 2, 3, 48, 64), 0.5))
    assert (completed > 0.2).all() and (completed < 0.31).all()


def test_network_pictures_keep_the_photos_shape_in_multiples_of_8():
    assert network_size((512, 512), 64) == (64, 64)
    assert network_size((300, 400), 64) == (48, 64)
    assert network_size((4000, 300), 64) == (64, 16)


def test_evidence_is_in_double_precision():
    maps = torch.zeros(1, 2, 4, 4)
    evidence = evidence_of(torch.zeros(1, 2, 4, 4, 2), maps, maps, maps, SCENE.views.intrinsics[:, :2])
    assert all(value.dtype == torch.float64 for value in vars(evidence).values())


def test_default_network_has_less_than_a_million_parameters():
    assert sum(p.numel() for p in MatchingNetwork().parameters()) < 1_000_000
