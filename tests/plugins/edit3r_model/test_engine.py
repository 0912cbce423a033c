"""The choice of precision, and strips against the whole maps that they replace."""

import itertools
from functools import partial

import pytest
import torch
from edit3r_model.dpt_head import double, in_strips, resized_rows, with_border
from edit3r_model.engine import EnginePlan, bfloat16_gain, make_plan
from torch import nn

import edit3r
from edit3r.contract.reporting import Report, collecting

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def _without_gradients():
    with torch.no_grad():
        yield


@pytest.mark.parametrize("rows", [1, 3, 8, 100])
def test_strips_equal_the_whole_map(rows):
    conv, half = nn.Conv2d(4, 4, 3, padding=(0, 1)), torch.randn(1, 4, 5, 7)
    fine = partial(resized_rows, half, (10, 14))

    def strip(start, stop):
        return conv(with_border(fine, start, stop, 10, 1))

    whole = nn.functional.conv2d(double(half), conv.weight, conv.bias, padding=1)
    strips = in_strips(10, rows, strip)
    torch.testing.assert_close(strips, whole, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("height", [1, 2, 5])
def test_rows_of_a_resized_map_are_its_rows(height):
    x = torch.randn(1, 2, height, 3)
    twice = (2 * height, 6)
    torch.testing.assert_close(resized_rows(x, twice, 0, 2 * height), double(x))
    for size in (twice, (7 * height // 4, 5), (height, 3), (1, 2)):
        whole = nn.functional.interpolate(x, size, mode="bilinear", align_corners=True)
        for start, stop in ((0, size[0]), (0, 1), (size[0] // 2, size[0])):
            rows = resized_rows(x, size, start, stop)
            expected = whole[:, :, start:stop]
            torch.testing.assert_close(rows, expected, atol=1e-6, rtol=1e-5)


@pytest.fixture
def gain(monkeypatch):
    """Say how much faster than float32 this machine multiplies in bfloat16."""
    return lambda value: monkeypatch.setattr(
        "edit3r_model.engine.bfloat16_gain", lambda device: value
    )


@pytest.mark.parametrize(
    ("faster", "chosen"), [(0.25, "float32"), (1.0, "float32"), (2.0, "bfloat16")]
)
def test_auto_takes_bfloat16_only_where_it_was_measured_to_be_faster(
    faster, chosen, gain
):
    gain(faster)
    assert make_plan("auto", "auto", CPU) == EnginePlan(chosen, chosen)


def test_bfloat16_gives_way_to_float32_where_it_is_slower_and_the_run_says_so(gain):
    gain(0.25)
    with collecting(Report()) as report:
        assert make_plan("bfloat16", "auto", CPU) == EnginePlan("float32", "float32")
    assert any("4.0 times as long in bfloat16" in text for text in report.warnings)


def test_the_gain_is_a_ratio_of_times(monkeypatch):
    """A clock on which bfloat16 takes a third of float32's time."""
    ticks = itertools.cycle((0.0, 0.03, 1.0, 1.01))
    monkeypatch.setattr("edit3r_model.engine._clock", lambda device: next(ticks))
    assert bfloat16_gain.__wrapped__(CPU) == pytest.approx(3)


@pytest.mark.slow
@pytest.mark.parametrize("head", ["auto", "float32", "bfloat16"])
@pytest.mark.parametrize("backbone", ["float32", "bfloat16"])
def test_any_precision_of_the_head_goes_with_any_of_the_backbone(backbone, head, gain):
    gain(2.0)
    built = edit3r.build(
        "reconstructor",
        "noposplat",
        weights="random",
        backbone={"width": 64, "depth": 1, "decoder_width": 64, "decoder_depth": 4},
        head={"feature_width": 64, "point_width": 64, "layer_widths": (64,) * 4},
        precision=backbone,
        head_precision=head,
    )
    images = torch.rand(1, 2, 3, 32, 32)
    gaussians = built.network(images, torch.eye(3).expand(1, 2, 3, 3))
    assert gaussians.means.dtype == torch.float32 and gaussians.means.isfinite().all()
