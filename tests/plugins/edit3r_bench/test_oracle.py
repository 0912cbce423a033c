"""The stand-in editor: the truth, and how it is spoiled."""

import pytest
import torch
from edit3r_bench.oracle import (
    FAULTS,
    OracleEditor,
    OracleSettings,
    fault_of,
    slightly_off,
    spoil,
)

from edit3r.contract.types import EditRequest, Views


@pytest.fixture
def truth():
    ramp = torch.linspace(0.1, 0.9, 32)
    return torch.stack(
        (ramp.expand(32, 32), ramp[:, None].expand(32, 32), torch.full((32, 32), 0.4))
    ).repeat(3, 1, 1, 1)


def edited(truth, seed=0, **settings):
    views = Views(
        torch.zeros(1, *truth.shape), torch.eye(3).expand(1, len(truth), 3, 3)
    )
    editor = OracleEditor(truth, OracleSettings(**settings))
    return editor.edit(views, EditRequest("anything", seed)).images[0]


def test_without_disagreement_every_view_is_the_truth(truth):
    assert torch.allclose(
        edited(truth, disagreement=0, reference="spoiled"), truth, atol=1e-5
    )


def test_the_reference_is_exact_and_the_others_disagree_with_it_and_with_each_other(
    truth,
):
    images = edited(truth, disagreement=0.5)
    assert torch.equal(images[0], truth[0])
    assert (images[1] - truth[1]).abs().mean() > 0.03
    assert (images[1] - images[2]).abs().mean() > 0.03


def test_the_reference_may_be_spoiled_like_the_others(truth):
    assert (
        edited(truth, disagreement=0.5, reference="spoiled")[0] - truth[0]
    ).abs().mean() > 0.02


def test_the_dial_turns_disagreement_up(truth):
    off = [
        sum(
            float(
                (edited(truth, seed, disagreement=amount)[1:] - truth[1:]).abs().mean()
            )
            for seed in range(5)
        )
        for amount in (0.1, 0.4, 1.0)
    ]
    assert off[0] < off[1] < off[2]


def test_the_same_seed_gives_the_same_pictures_and_another_others(truth):
    assert torch.equal(edited(truth, 7), edited(truth, 7))
    assert not torch.equal(edited(truth, 7)[1], edited(truth, 8)[1])


def test_spoiled_pictures_stay_in_range(truth):
    for view in range(20):
        image = spoil(truth[0], ("x", view), 1.0)
        assert image.min() >= 0 and image.max() <= 1


def test_half_of_the_references_are_off_each_fault_as_often():
    faults = [fault_of("recolor the object", seed) for seed in range(600)]
    assert 0.45 < faults.count("") / 600 < 0.55
    assert all(0.12 < faults.count(fault) / 600 < 0.21 for fault in FAULTS)


def test_each_fault_is_of_the_stated_amount(truth):
    sharp = torch.zeros(3, 100, 100)
    sharp[:, :, 50:] = 0.5
    assert torch.equal(slightly_off(sharp, ""), sharp)
    assert slightly_off(sharp, "shifted")[0, 50].tolist() == pytest.approx(
        [0.0] * 51 + [0.5] * 49, abs=1e-4
    )
    assert slightly_off(sharp, "coloured")[:, 0, 60].tolist() == pytest.approx(
        [0.575, 0.5, 0.425]
    )
    edge = slightly_off(sharp, "blurred")[0, 50]
    # of a step: a normal density, 1.2 pixels wide at 100 pixels
    spread = (edge[1:] - edge[:-1]) / 0.5
    places = torch.arange(1, 100) - 0.5
    middle = float((places * spread).sum())
    assert float(((places - middle) ** 2 * spread).sum()) ** 0.5 == pytest.approx(
        1.2, abs=0.03
    )


def test_only_an_off_reference_differs_between_the_two_settings(truth):
    seeds = {bool(fault_of("anything", seed)): seed for seed in range(20)}
    for off, seed in seeds.items():
        exact, half = (
            edited(truth, seed, reference=which) for which in ("exact", "off-in-half")
        )
        assert torch.equal(exact[1:], half[1:])
        assert torch.equal(exact[0], half[0]) is not off
