import json

import pytest
import torch
from edit3r_recolor.parameters import (
    JITTERS,
    PCA_DIRECTIONS,
    RecolorParameters,
    RecolorRanges,
    sample_parameters,
)
from hypothesis import given
from hypothesis import strategies as st


def sample(seed: int, ranges: RecolorRanges | None = None) -> RecolorParameters:
    return sample_parameters(torch.Generator().manual_seed(seed), ranges or RecolorRanges())


@given(st.integers(0, 2**31))
def test_parameters_survive_json_exactly(seed):
    parameters = sample(seed)
    assert RecolorParameters.from_json(json.loads(json.dumps(parameters.to_json()))) == parameters


@given(st.integers(0, 2**31))
def test_samples_stay_in_their_ranges(seed):
    ranges = RecolorRanges(brightness=0.2, contrast=0.1, saturation=0.9, hue=0.3, gamma=2)
    drawn = sample(seed, ranges)
    assert abs(drawn.brightness - 1) <= 0.2 and abs(drawn.contrast - 1) <= 0.1 and abs(drawn.saturation - 1) <= 0.9
    assert abs(drawn.hue) <= 0.3 and 0.5 <= drawn.gamma <= 2
    assert sorted(drawn.order) == sorted(JITTERS) and sorted(drawn.permutation) == [0, 1, 2]


def test_the_seed_alone_decides():
    assert sample(7) == sample(7)
    assert len({str(sample(seed)) for seed in range(20)}) == 20


def test_ranges_of_zero_leave_colours_alone():
    ranges = {"brightness": 0, "contrast": 0, "saturation": 0, "hue": 0, "gamma": 1, "lighting": 0}
    drawn = sample(3, RecolorRanges(**ranges, permute_probability=0, greyscale_probability=0))
    assert drawn == RecolorParameters(order=drawn.order)


def test_probabilities_are_kept_over_many_samples():
    drawn = [sample(seed, RecolorRanges(permute_probability=1, greyscale_probability=0.25)) for seed in range(400)]
    assert 0.15 < sum(p.greyscale for p in drawn) / 400 < 0.35
    assert len({p.permutation for p in drawn}) == 6


def test_lighting_directions_are_orthonormal():
    directions = torch.tensor(PCA_DIRECTIONS, dtype=torch.float64)
    assert torch.allclose(directions @ directions.T, torch.eye(3, dtype=torch.float64), atol=1e-3)


@pytest.mark.parametrize("wrong", [{"order": ("hue",)}, {"permutation": (0, 0, 1)}])
def test_impossible_orders_are_refused(wrong):
    with pytest.raises(ValueError, match="RecolorParameters"):
        RecolorParameters(**wrong)
