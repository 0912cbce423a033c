"""Vectors inside kernels against numpy."""

import numpy as np
import pytest
from edit3r_rasterizers.simd import (
    broadcast,
    exp2,
    flag_negative,
    log2,
    lowest_bit,
    magnitude,
    mask_bits,
    maximum,
    minimum,
    select,
)
from edit3r_rasterizers.simd_memory import (
    flat,
    load,
    load_block,
    store,
    store_block,
    store_sums,
)
from numba import njit

F, U = np.float32, np.uint64


@njit
def arithmetic(x, y, out):
    x, y, out = flat(x), flat(y), flat(out)
    a, b = load(x, U(0)), load(y, U(0))
    positive = (a > b) & (broadcast(F(0.5)) >= b)
    result = select(positive, a * b + F(2), a / maximum(b, F(0.25)))
    store(out, U(0), minimum(result, F(3)) - flag_negative(positive, magnitude(b)))
    return mask_bits(positive)


@njit
def powers(x, out):
    x, out = flat(x), flat(out)
    store(out, U(0), exp2(load(x, U(0))))


@njit
def logarithms(x, out):
    x, out = flat(x), flat(out)
    store(out, U(0), log2(load(x, U(0))))


@njit
def sums(x, out):
    x, out = flat(x), flat(out)
    a, b, c = load(x, U(0)), load(x, U(16)), load(x, U(32))
    store_sums(out, U(1), (a, b, c))


@njit
def move_block(picture, out, offset, stride):
    picture, out = flat(picture), flat(out)
    store_block(out, U(offset), U(stride), load_block(picture, U(offset), U(stride)))


@njit
def first_set(bits):
    return lowest_bit(bits)


def test_arithmetic_and_masks():
    draw = np.random.default_rng(0)
    x, y, out = (
        draw.normal(size=16).astype(F),
        draw.uniform(0.1, 1, 16).astype(F),
        np.empty(16, F),
    )
    bits = arithmetic(x, y, out)
    positive = (x > y) & (y <= 0.5)
    assert bits == sum(1 << lane for lane in range(16) if positive[lane])
    expected = np.minimum(
        np.where(positive, x * y + 2, x / np.maximum(y, F(0.25))), 3
    ) - np.where(positive, -y, y)
    assert np.allclose(out, expected, rtol=1e-6)


def test_exp2_is_exact_to_a_few_bits():
    x = np.linspace(-100, 10, 16 * 400).astype(F).reshape(-1, 16)
    out = np.empty(16, F)
    for row in x:
        powers(row, out)
        assert np.abs(out / 2.0 ** row.astype(float) - 1).max() < 3e-7


def test_log2_is_exact_to_ten_digits():
    x = 2.0 ** np.linspace(-40, 40, 8 * 400).reshape(-1, 8)
    out = np.empty(8)
    for row in x:
        logarithms(row, out)
        assert np.abs(out - np.log2(row)).max() < 1e-9


def test_lane_sums_go_to_consecutive_places_and_nowhere_else():
    x, out = np.random.default_rng(0).normal(size=48).astype(F), np.full(8, 7, F)
    sums(x, out)
    assert np.allclose(out[1:4], x.reshape(3, 16).sum(1), atol=1e-5)
    assert (out[[0, 4, 5, 6, 7]] == 7).all()


def test_blocks_are_read_and_written_row_by_row():
    picture, out = np.arange(70, dtype=F).reshape(7, 10), np.zeros((7, 10), F)
    move_block(picture, out, 23, 10)
    expected = np.zeros_like(picture)
    expected[2:6, 3:7] = picture[2:6, 3:7]
    assert (out == expected).all()


@pytest.mark.parametrize("bit", [0, 5, 15, 63])
def test_lowest_bit(bit):
    assert first_set(np.uint64((1 << bit) | (1 << 63))) == bit
