"""The ways of editing a scene that the benchmark compares with."""

from types import SimpleNamespace

import pytest
import torch
from edit3r_bench.item import ItemRunner
from edit3r_bench.manifest import load_item
from edit3r_bench.measures import measure, remark
from edit3r_bench.method import Method

from edit3r.contract.reporting import Report
from edit3r.loading.registry import default_registry

EXACT = {"name": "oracle", "disagreement": 0.0}
NO_NETWORKS = SimpleNamespace(features=[], clip=None, distances={})


def first_item(manifest):
    return load_item(manifest, manifest.items[0], "", default_registry())


def outcome(manifest, cards, **method):
    """What a method shows of the first edit, and its figures."""
    chosen = {"editor": EXACT, "run": {"gaussians": "all", "refine": 0}, **method}
    made_by = Method(reconstructor={"name": "cards"}, **chosen)
    runner = ItemRunner(made_by, default_registry((cards,)))
    item = first_item(manifest)
    with torch.no_grad():
        output = runner(item, Report())
    return output, measure(item, output, NO_NETWORKS)


@pytest.mark.slow
def test_edited_renderings_carry_the_whole_edit_and_stay_a_rendering_elsewhere(
    manifest, cards
):
    edited, figures = outcome(manifest, cards, edit_renders=True)
    plain, before = outcome(manifest, cards, editor="none", truth=True)
    item = first_item(manifest)
    asked = (plain.images + item.truth - item.photos.images[0]).clamp(0, 1)
    assert (edited.images - asked).abs().max() < 0.02
    outside = (item.masks == 0)[:, None].expand_as(asked)
    assert torch.equal(edited.images[outside], plain.images[outside])
    assert figures["edit-uptake"] > 0.9
    assert abs(before["edit-uptake"]) < 0.2
    assert "left the reference unchanged" in remark(before)
    assert remark(figures) == ""


@pytest.mark.slow
def test_single_view_lifting_shows_the_reference_alone(manifest, cards):
    both, _ = outcome(manifest, cards)
    one, _ = outcome(manifest, cards, gaussians_of="first")
    assert one.gaussians == both.gaussians // 2 == 48 * 48


@pytest.mark.slow
def test_settings_of_the_run_reach_it(manifest, cards):
    few, _ = outcome(manifest, cards, run={"gaussians": 500, "refine": 0})
    assert few.gaussians <= 500
