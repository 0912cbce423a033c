"""The ways of editing a scene that the benchmark compares with, and what it asks of all: no
dependence on order.
"""

import numpy as np
import pytest
import torch
from edit3r_measure.bench_build import build_generated
from edit3r_measure.bench_item import BenchRun, Method, run_bench
from edit3r_measure.bench_manifest import load_item, write_bench_manifest
from edit3r_measure.bench_metrics import MetricSettings

from edit3r.io.images import read_image
from edit3r.plugins.registry import default_registry

EXACT = {"name": "oracle", "disagreement": 0.0}
PLAIN = {"gaussians": "all", "refine": 0}


@pytest.fixture(scope="module")
def three_inputs(small, tmp_path_factory):
    """One edit of a scene with three inputs and one held-back picture."""
    path = tmp_path_factory.mktemp("three") / "bench.json"
    write_bench_manifest(
        path,
        build_generated(1, small.model_copy(update={"inputs": 3}), default_registry()),
    )
    return path


def result_of(manifest_file, cards, out, settings=None, **method):
    reconstructor = {"name": "cards", **(settings or {})}
    chosen = Method(
        label="m",
        reconstructor=reconstructor,
        **{"editor": EXACT, "run": PLAIN, **method},
    )
    run = BenchRun(
        manifest_file,
        chosen,
        out,
        MetricSettings(effnet=False),
        edits=1,
        plugins=(cards,),
    )
    (result,) = run_bench(run).values()
    assert result.failure == ""
    return result


def strip(out, result, name):
    return torch.from_numpy(
        np.asarray(read_image(out / "pictures" / result.id / f"{name}.png"), np.float32)
        / 255
    )


def test_edited_renderings_carry_the_whole_edit_and_stay_a_rendering_elsewhere(
    manifest, manifest_file, cards, tmp_path
):
    edited = result_of(manifest_file, cards, tmp_path / "a", edit_renders=True)
    plain = result_of(manifest_file, cards, tmp_path / "b", editor="none", truth=True)
    item = load_item(manifest, manifest.items[0], tmp_path, default_registry())
    change = (item.truth - item.photos.images[0]).permute(0, 2, 3, 1)
    shown, before = (
        strip(tmp_path / name, r, "shown") for name, r in (("a", edited), ("b", plain))
    )
    wished = (before + torch.cat(list(change), 1)).clamp(0, 1)
    outside = torch.cat(list(item.masks == 0), -1)
    assert (shown - wished).abs().max() < 0.02 and torch.equal(
        shown[outside], before[outside]
    )
    assert edited.metrics["edit-uptake"] > 0.9 > 0.2 > abs(plain.metrics["edit-uptake"])
    assert "left the reference as it was" in plain.remark and edited.remark == ""


def test_single_view_lifting_shows_the_reference_alone(manifest_file, cards, tmp_path):
    both = result_of(manifest_file, cards, tmp_path / "both")
    one = result_of(manifest_file, cards, tmp_path / "one", gaussians_of="first")
    assert one.facts["gaussians"] == both.facts["gaussians"] // 2 == 48 * 48


def test_settings_of_the_run_reach_it(manifest_file, cards, tmp_path):
    few = result_of(
        manifest_file, cards, tmp_path / "few", run={"gaussians": 500, "refine": 0}
    )
    assert few.facts["gaussians"] <= 500


def test_a_reconstructor_that_takes_all_views_alike_does_not_mind_their_order(
    three_inputs, cards, tmp_path
):
    alike = result_of(three_inputs, cards, tmp_path / "alike")
    assert alike.metrics["order-change"] < 1e-4
    last = result_of(
        three_inputs, cards, tmp_path / "last", settings={"only_last": True}
    )
    assert last.metrics["order-change"] > 0.01


def test_with_two_inputs_there_is_no_other_order(manifest_file, cards, tmp_path):
    assert (
        "order-change" not in result_of(manifest_file, cards, tmp_path / "two").metrics
    )


def test_the_order_is_asked_with_the_same_2d_edits(three_inputs, cards, tmp_path):
    spoiled = {"name": "oracle", "disagreement": 1.0, "reference": "spoiled"}
    assert (
        result_of(three_inputs, cards, tmp_path / "x", editor=spoiled).metrics[
            "order-change"
        ]
        < 1e-4
    )
