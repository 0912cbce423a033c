"""The network against an independent float64 calculation from the same official state dict."""

import pytest
import torch
from edit3r_model.asymmetric_vit import assign_roles
from edit3r_model.checkpoints import fill, load_weights
from edit3r_model.dpt_head import double
from edit3r_model.network import built
from edit3r_model.transformer import NORM_EPS, Mlp, layer_norm
from noposplat_reference import Reference, to_gaussians

from edit3r.contract.settings import PartChoice
from edit3r.kit.geometry.rotations import covariances

CASES = {
    "two views, square": (1, 2, 32, 32),
    "three views, odd grid, batch 2": (2, 3, 48, 80),
    "two views, portrait": (1, 2, 64, 48),
    "four views, one patch row": (1, 4, 16, 32),
}


@pytest.fixture(scope="module")
def network(checkpoint, sizes):
    loaded = load_weights(checkpoint)
    heads = {"heads": sizes.heads, "decoder_heads": sizes.decoder_heads}
    settings = loaded.parts["backbone"].settings | heads
    backbone = PartChoice(name="asymmetric-vit", settings=settings)
    network = built({**loaded.parts, "backbone": backbone})
    for _ in fill(network, loaded):
        pass
    return network.eval()


@pytest.fixture(scope="module", params=CASES.values(), ids=CASES.keys())
def case(request, official_state, sizes):
    """(images, intrinsics, levels, raw points, raw parameters) of the independent calculation."""
    batch, views, height, width = request.param
    generator = torch.Generator().manual_seed(views)
    images = torch.rand(batch, views, 3, height, width, generator=generator)
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 1.1, 0.5], [0, 0, 1]])
    intrinsics = intrinsics.repeat(batch, views, 1, 1)
    # Every view its own field of view.
    intrinsics[:, :, 0, 0] += 0.2 * torch.rand(batch, views, generator=generator)
    reference = Reference(official_state, sizes)
    levels = reference.tokens(images, intrinsics)
    return images, intrinsics, levels, *reference.raw(levels, images)


def near(ours, expected, atol, rtol=0.0, **told):
    torch.testing.assert_close(ours.double(), expected, atol=atol, rtol=rtol, **told)


@torch.no_grad()
def test_all_token_levels_equal_the_independent_calculation(network, case):
    images, intrinsics, levels, *_ = case
    ours = network.backbone.forward_levels(images, intrinsics).levels
    assert len(ours) == 11
    for level, (mine, expected) in enumerate(zip(ours, levels, strict=True)):
        near(mine, expected, 2e-5, msg=f"level {level}")


@torch.no_grad()
def test_raw_maps_equal_the_independent_calculation(network, case):
    images, intrinsics, _, points, parameters = case
    features = network.backbone(images, intrinsics)
    near(network.head.raw_points(features), points, 2e-4)
    near(network.head.raw_parameters(features, images), parameters, 2e-4)


@torch.no_grad()
def test_gaussians_equal_the_independent_calculation(network, case):
    images, intrinsics, _, points, parameters = case
    ours, expected = network(images, intrinsics), to_gaussians(points, parameters)
    near(ours.means, expected["means"], 1e-3, 1e-4)
    near(ours.opacities, expected["opacities"], 1e-4)
    near(ours.scales, expected["scales"], 2e-6)
    near(ours.quats.roll(-1, -1), expected["quats"], 1e-4)
    near(ours.harmonics, expected["harmonics"], 5e-4)
    near(covariances(ours.scales, ours.quats), expected["covariances"], 1e-7)


def test_gaussians_are_ordered_view_major_then_row_major(network):
    images, intrinsics = torch.rand(1, 3, 3, 16, 32), torch.eye(3).repeat(1, 3, 1, 1)
    expected = torch.arange(3).repeat_interleave(512)
    assert torch.equal(network(images, intrinsics).view_index, expected)


@torch.no_grad()
def test_portrait_keeps_attributes_at_their_pixels(network):
    """A pixel's opacity depends on the picture near it: a change low down must not move to another
    place.
    """
    images = torch.rand(1, 2, 3, 96, 48)
    features = network.backbone(images, torch.eye(3).repeat(1, 2, 1, 1))
    changed = images.clone()
    changed[0, 0, :, 80, 10] = 1 - changed[0, 0, :, 80, 10]
    before = network.head.raw_parameters(features, images)
    moved = network.head.raw_parameters(features, changed) - before
    for at, place in zip((80, 10), moved[0, 0].abs().sum(0).nonzero(as_tuple=True)):
        assert place.min() >= at - 4 and place.max() <= at + 4  # 7x7, then 3x3


@torch.no_grad()
def test_order_of_views_after_the_first_only_permutes_their_gaussians(network):
    images, intrinsics = torch.rand(1, 3, 3, 32, 32), torch.eye(3).repeat(1, 3, 1, 1)
    straight = network(images, intrinsics)
    swapped = network(images[:, [0, 2, 1]], intrinsics)
    for view, other in ((0, 0), (1, 2)):
        expected = swapped.from_view(other).means.double()
        near(straight.from_view(view).means, expected, 1e-4, 1e-4)


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
    near(mlp.double()(x), exact, 1e-12)  # the tanh form differs by 3e-4


def test_doubling_keeps_corners_and_a_linear_ramp():
    ramp = torch.linspace(0, 1, 5)[None, None, :, None].expand(1, 1, 5, 3)
    doubled = double(ramp)
    torch.testing.assert_close(doubled[0, 0, :, 0], torch.linspace(0, 1, 10))
