"""The network against an independent float64 calculation from the same official state dict."""

import pytest
import torch
from edit3r_model.backbone import assign_roles
from edit3r_model.checkpoints import fill, load_weights
from edit3r_model.dpt_head import double
from edit3r_model.full_network import empty_network
from edit3r_model.transformer import NORM_EPS, Mlp, layer_norm
from noposplat_reference import Reference, to_gaussians

from edit3r.errors import InputError
from edit3r.geometry.rotations import covariances

CASES = {
    "two views, square": (1, 2, 32, 32),
    "three views, odd grid, batch 2": (2, 3, 48, 80),
    "two views, portrait": (1, 2, 64, 48),
    "four views, one patch row": (1, 4, 16, 32),
}


@pytest.fixture(scope="module")
def network(checkpoint, sizes):
    loaded = load_weights(checkpoint)
    network = empty_network(
        loaded.config, heads=sizes.heads, decoder_heads=sizes.decoder_heads
    )
    for _ in fill(network, loaded):
        pass
    return network.eval()


@pytest.fixture(scope="module", params=CASES.values(), ids=CASES.keys())
def case(request, official_state, sizes):
    """(images, intrinsics, levels, raw points, raw parameters) of the independent calculation."""
    batch, views, height, width = request.param
    generator = torch.Generator().manual_seed(views)
    images = torch.rand(batch, views, 3, height, width, generator=generator)
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 1.1, 0.5], [0, 0, 1]]).repeat(
        batch, views, 1, 1
    )
    intrinsics[:, :, 0, 0] += 0.2 * torch.rand(
        batch, views, generator=generator
    )  # every view its own field of view
    reference = Reference(official_state, sizes)
    levels = reference.tokens(images, intrinsics)
    return images, intrinsics, levels, *reference.raw(levels, images)


@torch.no_grad()
def test_all_token_levels_equal_the_independent_calculation(network, case):
    images, intrinsics, levels, *_ = case
    ours = network.backbone.forward_levels(images, intrinsics).levels
    assert len(ours) == len(levels) == 11
    for level, (mine, reference) in enumerate(zip(ours, levels)):
        torch.testing.assert_close(
            mine.double(),
            reference,
            atol=2e-5,
            rtol=0,
            msg=lambda m, i=level: f"level {i}: {m}",
        )


@torch.no_grad()
def test_raw_maps_equal_the_independent_calculation(network, case):
    images, intrinsics, _, points, parameters = case
    features = network.backbone(images, intrinsics)
    torch.testing.assert_close(
        network.head.raw_points(features).double(), points, atol=2e-4, rtol=0
    )
    torch.testing.assert_close(
        network.head.raw_parameters(features, images).double(),
        parameters,
        atol=2e-4,
        rtol=0,
    )


@torch.no_grad()
def test_gaussians_equal_the_independent_calculation(network, case):
    images, intrinsics, _, points, parameters = case
    ours, expected = network(images, intrinsics), to_gaussians(points, parameters)
    reference_covariances = expected["covariances"]
    torch.testing.assert_close(
        ours.means.double(), expected["means"], atol=1e-3, rtol=1e-4
    )
    torch.testing.assert_close(
        ours.opacities.double(), expected["opacities"], atol=1e-4, rtol=0
    )
    torch.testing.assert_close(
        ours.scales.double(), expected["scales"], atol=2e-6, rtol=0
    )
    torch.testing.assert_close(
        ours.quats.roll(-1, -1).double(), expected["quats"], atol=1e-4, rtol=0
    )
    torch.testing.assert_close(
        ours.harmonics.double(), expected["harmonics"], atol=5e-4, rtol=0
    )
    torch.testing.assert_close(
        covariances(ours.scales, ours.quats).double(),
        reference_covariances,
        atol=1e-7,
        rtol=0,
    )


def test_gaussians_are_ordered_view_major_then_row_major(network):
    images, intrinsics = torch.rand(1, 3, 3, 16, 32), torch.eye(3).repeat(1, 3, 1, 1)
    assert (
        network(images, intrinsics).view_index.tolist()
        == [0] * 512 + [1] * 512 + [2] * 512
    )


@torch.no_grad()
def test_portrait_keeps_attributes_at_their_pixels(network):
    """A pixel's opacity depends on the picture near it: a change low down must not move to another
    place.
    """
    images = torch.rand(1, 2, 3, 96, 48)
    features = network.backbone(images, torch.eye(3).repeat(1, 2, 1, 1))
    changed = images.clone()
    changed[0, 0, :, 80, 10] = 1 - changed[0, 0, :, 80, 10]
    difference = (
        network.head.raw_parameters(features, changed)
        - network.head.raw_parameters(features, images)
    ).abs()
    rows, columns = difference[0, 0].sum(0).nonzero(as_tuple=True)
    assert (
        rows.min() >= 76
        and rows.max() <= 84
        and columns.min() >= 6
        and columns.max() <= 14
    )  # 7x7, then 3x3


@torch.no_grad()
def test_order_of_views_after_the_first_only_permutes_their_gaussians(network):
    images, intrinsics = torch.rand(1, 3, 3, 32, 32), torch.eye(3).repeat(1, 3, 1, 1)
    straight, swapped = (
        network(images, intrinsics),
        network(images[:, [0, 2, 1]], intrinsics),
    )
    torch.testing.assert_close(
        straight.from_view(0).means, swapped.from_view(0).means, atol=1e-4, rtol=1e-4
    )
    torch.testing.assert_close(
        straight.from_view(1).means, swapped.from_view(2).means, atol=1e-4, rtol=1e-4
    )


def test_each_view_reads_every_other_view_in_order():
    reference, others = assign_roles(4)
    assert (reference.own, reference.sources) == (slice(0, 1), slice(1, 4))
    assert reference.reads.tolist() == [[0, 1, 2]]
    assert others.reads.tolist() == [[0, 2, 3], [0, 1, 3], [0, 1, 2]]


def test_two_views_project_no_memory_that_nobody_reads():
    assert assign_roles(2)[1].sources == slice(0, 1)


def test_layer_norm_has_the_small_epsilon_that_near_constant_tokens_show():
    x = torch.tensor([[1.0, 1.001]])
    variance = x.double().var(unbiased=False)
    expected = (x.double() - x.double().mean()) / (variance + 1e-6).sqrt()
    assert NORM_EPS == 1e-6
    torch.testing.assert_close(layer_norm(2)(x).double(), expected, atol=1e-3, rtol=0)


def test_mlp_uses_the_exact_gelu():
    mlp = Mlp(1, 1)
    for layer in (mlp.fc1, mlp.fc2):
        layer.weight.data.fill_(1.0), layer.bias.data.zero_()
    x = torch.tensor([[-2.0], [0.5], [2.0]], dtype=torch.float64)
    exact = x * 0.5 * (1 + torch.erf(x / 2**0.5))
    torch.testing.assert_close(
        mlp.double()(x), exact, atol=1e-12, rtol=0
    )  # the tanh form differs by 3e-4


def test_doubling_keeps_corners_and_a_linear_ramp():
    ramp = torch.linspace(0, 1, 5)[None, None, :, None].expand(1, 1, 5, 3)
    doubled = double(ramp)
    torch.testing.assert_close(doubled[0, 0, :, 0], torch.linspace(0, 1, 10))


@pytest.mark.parametrize("shape", [(1, 2, 3, 40, 32), (1, 2, 3, 8, 32)])
def test_sides_that_are_no_multiple_of_the_patch_are_an_error_with_the_size(
    network, shape
):
    with pytest.raises(InputError, match=f"{shape[3]}x{shape[4]}"):
        network(torch.rand(shape), torch.eye(3).repeat(1, 2, 1, 1))


def test_one_view_is_an_error_that_asks_for_two(network):
    with pytest.raises(InputError, match="at least 2 views"):
        network(torch.rand(1, 1, 3, 32, 32), torch.eye(3)[None, None])
