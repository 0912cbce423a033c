"""Faster layers against the plain ones they replace."""

from functools import partial

import pytest
import torch
from edit3r_model.dpt_head import double, double_rows, in_strips, with_border
from edit3r_model.engine import make_plan
from edit3r_model.fast_layers import (
    FusedConv,
    Int8Conv,
    Int8Linear,
    PackedLinear,
    StoredLinear,
    quantise_input,
    quantise_weight,
)
from edit3r_model.winograd import WinogradConv
from torch import nn

from edit3r.errors import SettingsError

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def _without_gradients():
    with torch.no_grad():
        yield


@pytest.mark.parametrize("rows", [1, 37, 700])  # 512 is what the layout is chosen for
@pytest.mark.parametrize("activation", ["none", "gelu"])
def test_packed_linear_equals_the_plain_one(rows, activation):
    linear, x = nn.Linear(48, 72), torch.randn(2, rows, 48)
    expected = linear(x) if activation == "none" else nn.functional.gelu(linear(x))
    torch.testing.assert_close(PackedLinear(linear, torch.float32, activation)(x), expected, atol=1e-5, rtol=1e-5)


def test_packed_linear_in_bf16_rounds_and_no_more():
    linear, x = nn.Linear(64, 64), torch.randn(9, 64)
    result = PackedLinear(linear, torch.bfloat16)(x)
    assert result.dtype == torch.bfloat16
    assert (result.float() - linear(x)).norm() / linear(x).norm() < 0.01


@pytest.mark.parametrize("activation", ["none", "gelu"])
def test_stored_layers_err_by_the_rounding_of_their_weights_alone(activation):
    linear, x = nn.Linear(48, 72), torch.randn(2, 9, 48)
    linear.weight.data = linear.weight.data.bfloat16().float()
    expected = linear(x) if activation == "none" else nn.functional.gelu(linear(x))
    stored = StoredLinear(linear, activation)
    assert stored.weight.dtype == torch.bfloat16
    torch.testing.assert_close(stored(x), expected, atol=1e-5, rtol=1e-5)

    conv, x = nn.Conv2d(5, 6, 3, padding=1), torch.randn(1, 5, 9, 11)
    conv.weight.data = conv.weight.data.bfloat16().float()
    stored = FusedConv(conv, torch.bfloat16, "relu", arithmetic=torch.float32)
    assert stored.weight.dtype == torch.bfloat16
    torch.testing.assert_close(stored(x), conv(x).relu(), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("activation", ["none", "relu"])
@pytest.mark.parametrize(("kernel", "stride"), [(1, 1), (3, 1), (3, 2), (7, 1)])
def test_fused_conv_equals_the_plain_one(kernel, stride, activation):
    conv, x = nn.Conv2d(5, 6, kernel, stride, padding=kernel // 2), torch.randn(2, 5, 9, 11)
    expected = conv(x).relu() if activation == "relu" else conv(x)
    torch.testing.assert_close(FusedConv(conv, torch.float32, activation)(x), expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("size", [(3, 1), (4, 4), (5, 9), (34, 70)])
@pytest.mark.parametrize("padding", [(1, 1), (0, 1)])
@pytest.mark.parametrize("bias", [False, True])
def test_winograd_equals_the_plain_convolution_for_any_size(size, padding, bias):
    conv, x = nn.Conv2d(6, 7, 3, padding=padding, bias=bias), torch.randn(2, 6, *size)
    torch.testing.assert_close(WinogradConv(conv)(x), conv(x), atol=2e-5, rtol=1e-5)


def test_winograd_rounds_little_with_many_channels():
    conv, x = nn.Conv2d(256, 64, 3, padding=1), torch.randn(1, 256, 20, 20)
    exact = nn.functional.conv2d(x.double(), conv.weight.double(), conv.bias.double(), padding=1)
    assert (WinogradConv(conv)(x) - exact).abs().max() / exact.abs().max() < 3e-5


def test_winograd_refuses_other_kernels():
    with pytest.raises(ValueError, match="3x3"):
        WinogradConv(nn.Conv2d(3, 3, 5))


@pytest.mark.parametrize("shift", [0.0, 30.0, -30.0])
def test_int8_linear_errs_by_about_a_percent_of_its_range(shift):
    linear, x = nn.Linear(128, 96), torch.randn(40, 128) + shift
    expected = linear(x)
    error = (Int8Linear(linear)(x) - expected).norm() / expected.norm()
    assert error < (0.02 if shift == 0 else 0.04)


@pytest.mark.parametrize("size", [(12, 12), (1, 1), (1, 7)])  # one pixel has every layout at once
def test_int8_conv_errs_by_about_a_percent_whatever_the_inputs_scale(size):
    conv = nn.Conv2d(64, 64, 3, padding=1)
    for scale in (1e-3, 1.0, 1e3):
        x = scale * torch.randn(1, 64, *size)
        bias_free = nn.functional.conv2d(x, conv.weight, padding=1)
        error = Int8Conv(conv)(x) - conv.bias[:, None, None] - bias_free
        assert error.norm() / bias_free.norm() < 0.02


def test_quantised_inputs_never_wrap_around():
    for x in (torch.tensor([0.0, 0.0]), torch.tensor([-3.0, -1.0]), torch.tensor([2.0, 7.0]), 100 * torch.randn(1000)):
        values, scale, zero = quantise_input(x)
        assert 0 <= zero <= 255
        assert ((values.float() - zero) * scale - x).abs().max() <= 0.51 * scale + 1e-6


def test_weights_of_a_silent_channel_quantise_to_zero():
    weight, scales = quantise_weight(torch.tensor([[0.0, 0.0], [1.0, -2.0]]))
    assert weight.tolist() == [[0, 0], [64, -127]] and scales.isfinite().all()


@pytest.mark.parametrize("rows", [1, 3, 8, 100])
def test_strips_equal_the_whole_map(rows):
    conv, half = nn.Conv2d(4, 4, 3, padding=(0, 1)), torch.randn(1, 4, 5, 7)
    strips = in_strips(10, rows, lambda start, stop: conv(with_border(partial(double_rows, half), start, stop, 10, 1)))
    whole = nn.functional.conv2d(double(half), conv.weight, conv.bias, padding=1)
    torch.testing.assert_close(strips, whole, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("height", [1, 2, 5])
def test_rows_of_a_doubled_map_are_its_rows(height):
    x = torch.randn(1, 2, height, 3)
    for start, stop in ((0, 2 * height), (0, 1), (height, 2 * height)):
        torch.testing.assert_close(double_rows(x, start, stop), double(x)[:, :, start:stop], atol=1e-6, rtol=1e-5)


def test_heads_beside_int8_follow_what_the_processor_multiplies(monkeypatch):
    monkeypatch.setattr("edit3r_model.engine._cpu_info", lambda: "flags: avx512_bf16")
    assert make_plan("int8", "auto", True, CPU).head == "bfloat16"
    monkeypatch.setattr("edit3r_model.engine._cpu_info", lambda: "flags: avx2")
    assert make_plan("int8", "auto", True, CPU).head == "int8"


@pytest.mark.parametrize(
    ("flags", "form"), [("avx512f avx2", "stored"), ("avx512_bf16", "bfloat16"), ("asimd bf16", "bfloat16")]
)
def test_bfloat16_is_only_stored_where_the_processor_would_emulate_it(flags, form, monkeypatch):
    monkeypatch.setattr("edit3r_model.engine._cpu_info", lambda: f"flags: {flags}")
    assert make_plan("bfloat16", "auto", True, CPU).backbone == form
    assert make_plan("bfloat16", "auto", False, CPU).backbone == "bfloat16"  # plain layers: as asked


def test_int8_needs_the_packed_engine():
    with pytest.raises(SettingsError, match="engine packed"):
        make_plan("int8", "auto", False, CPU)
