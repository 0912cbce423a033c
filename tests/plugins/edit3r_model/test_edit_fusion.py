import torch
from edit3r_model.edit_colour import shown_by_views
from edit3r_model.edit_fusion import EditTransport
from edit3r_model.small_backbone import convex_upsample
from edit3r_model.small_head import Decisions, fuse_colours

from edit3r.geometry.cameras import pixel_grid
from edit3r.geometry.warping import Correspondences

ROWS, COLUMNS, WIDTH = 6, 8, 16


def _transport() -> EditTransport:
    torch.manual_seed(0)
    return EditTransport(WIDTH).eval()


def _inputs(batch: int = 2):
    torch.manual_seed(1)
    tokens, reference = (
        torch.randn(batch, WIDTH, ROWS, COLUMNS),
        torch.randn(batch, WIDTH, ROWS, COLUMNS),
    )
    places = pixel_grid((ROWS, COLUMNS), tokens).expand(batch, -1, -1, -1)
    return (
        tokens,
        reference,
        places,
        torch.randn(batch, 12, ROWS, COLUMNS),
        torch.rand(batch, 9, ROWS, COLUMNS),
    )


@torch.no_grad()
def test_no_edit_stays_no_edit():
    tokens, reference, places, maps, colours = _inputs()
    assert (
        _transport()(tokens, reference, places, torch.zeros_like(maps), colours).maps
        == 0
    ).all()


@torch.no_grad()
def test_attention_equals_its_definition():
    """exp(alike - reach |place - key|^2) over all keys and the null key, mixed over heads, written
    out.
    """
    transport = _transport()
    tokens, reference, places, maps, colours = _inputs(1)
    carried = transport(tokens, reference, places, maps, colours)
    query, key = transport._embed(tokens), transport._embed(reference)
    alike = query @ key.transpose(-1, -2) * transport.temperature.exp()[:, None, None]
    cells = pixel_grid((ROWS, COLUMNS), tokens).reshape(-1, 2) * torch.tensor(
        [COLUMNS, ROWS]
    )
    wanted = places.reshape(-1, 2) * torch.tensor([COLUMNS, ROWS])
    reach = torch.nn.functional.softplus(transport.reach(tokens)).flatten(2)[..., None]
    logits = alike - reach * torch.cdist(wanted, cells).square()
    null = transport.null[None, :, None, None].expand(1, -1, ROWS * COLUMNS, 1)
    attention = torch.cat((null, logits), -1).softmax(-1)
    values = torch.cat((maps, colours), 1).flatten(2).transpose(1, 2)
    mix = transport.head_mix(tokens).softmax(1).flatten(2)[..., None]
    expected = (
        (mix * (attention[..., 1:] @ values))
        .sum(1)
        .transpose(1, 2)
        .reshape(1, 21, ROWS, COLUMNS)
    )
    assert torch.allclose(
        torch.cat((carried.maps, carried.colours), 1), expected, atol=1e-4
    )
    assert torch.allclose(carried.evidence.flatten(2), 1 - attention[..., 0], atol=1e-5)


@torch.no_grad()
def test_a_short_reach_takes_what_lies_at_the_matched_place():
    transport = _transport()
    tokens, reference, places, maps, colours = _inputs()
    transport.reach.bias.fill_(50.0)
    transport.null.fill_(-50.0)
    carried = transport(tokens, reference, places, maps, colours)
    assert torch.allclose(carried.maps, maps, atol=1e-3)


@torch.no_grad()
def test_places_far_outside_the_reference_find_no_evidence():
    transport = _transport()
    tokens, reference, places, maps, colours = _inputs()
    transport.reach.bias.fill_(3.0)
    carried = transport(tokens, reference, places + 2, maps, colours)
    assert carried.evidence.max() < 1e-3 and carried.maps.abs().max() < 1e-2


def test_convex_upsampling_stays_between_neighbours_and_picks_the_one_it_is_told():
    values = torch.rand(1, 2, 5, 5)
    fine = convex_upsample(values, torch.randn(1, 36, 5, 5))
    assert fine.shape == (1, 2, 10, 10)
    assert fine.min() >= values.min() and fine.max() <= values.max()
    logits = torch.full((1, 36, 5, 5), -50.0)
    logits[:, 16:20] = 50.0  # the centre neighbour for all four fine pixels
    nearest = torch.nn.functional.interpolate(values, scale_factor=2, mode="nearest")
    assert torch.allclose(convex_upsample(values, logits), nearest)


def test_a_carried_map_changes_no_colour_more_than_the_reference_was_changed():
    """A dark hole was painted green, the darker the more. Bright bark beside it must not turn
    pink.
    """
    source = torch.full((1, 2, 3, 4, 4), 0.7)
    source[:, 0] = torch.linspace(0, 0.1, 16).reshape(4, 4)
    edited = source.clone()
    edited[:, 0, 1] += 0.6 - 2 * source[:, 0, 1]
    maps = torch.zeros(1, 2, 12, 4, 4)
    maps[:, 1, 4], maps[:, 1, 10] = (
        -2,
        0.6,
    )  # the same function of green: 0.6 - 2 * 0.7 = -0.8 on the bark
    choice = torch.zeros(1, 2, 3, 4, 4)
    choice[:, 1, 1] = 1
    none = torch.zeros(1, 2, 4, 4)
    decisions = Decisions(
        none,
        none,
        none,
        torch.tensor([1.0, 1, 1, 0, 0, 0]).view(1, 1, 6, 1, 1).expand(1, 2, -1, 1, 1),
        maps,
        choice,
    )
    places = pixel_grid((4, 4), source).expand(1, 2, -1, -1, -1)
    shown = shown_by_views(edited, source, decisions.looks)
    fused = fuse_colours(
        edited,
        source,
        shown,
        decisions,
        Correspondences(places, none, none),
        torch.ones_like(none),
    )
    assert torch.equal(fused[:, 1], source[:, 1])
    dark = torch.cat((source[:, :1], source[:, :1]), 1)
    fused = fuse_colours(
        edited,
        dark,
        shown,
        decisions,
        Correspondences(places, none, none),
        torch.ones_like(none),
    )
    assert torch.allclose(fused[:, 1], edited[:, 0], atol=1e-6)
