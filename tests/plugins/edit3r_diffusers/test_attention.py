"""Cross-view attention by what must be true of it."""

from importlib import import_module

import pytest
import torch
from edit3r_diffusers.attention import CrossViewAttention


@pytest.fixture
def attention():
    return import_module("diffusers.models.attention_processor")


@pytest.fixture
def attn(attention):
    torch.manual_seed(0)
    return attention.Attention(query_dim=16, heads=2, dim_head=8).eval()


def test_with_weight_zero_it_is_the_ordinary_attention(attn, attention):
    tokens = torch.randn(6, 5, 16)
    expected = attention.AttnProcessor2_0()(attn, tokens)
    assert torch.allclose(
        CrossViewAttention(3, 2, 0.0)(attn, tokens), expected, atol=1e-6
    )


def test_equal_views_make_the_weight_irrelevant(attn, attention):
    tokens = torch.randn(2, 1, 5, 16).expand(2, 3, 5, 16).flatten(0, 1)
    expected = attention.AttnProcessor2_0()(attn, tokens)
    assert torch.allclose(
        CrossViewAttention(3, 3, 0.7)(attn, tokens), expected, atol=1e-5
    )


def test_with_weight_one_and_one_reference_only_view_0_is_looked_at(attn):
    tokens = torch.randn(6, 5, 16)
    out = CrossViewAttention(3, 1, 1.0)(attn, tokens)
    changed = tokens.clone()
    changed[[2, 5]] += 1  # view 2 of both guidance halves
    again = CrossViewAttention(3, 1, 1.0)(attn, changed)
    assert torch.allclose(out[[0, 1, 3, 4]], again[[0, 1, 3, 4]], atol=1e-6)
    changed[0] += 1  # view 0 of the first half reaches the views of that half only
    third = CrossViewAttention(3, 1, 1.0)(attn, changed)
    assert not torch.allclose(again[1], third[1], atol=1e-4)
    assert torch.allclose(again[4], third[4], atol=1e-6)
