"""The single pass at its door and at the extremes of what may come through it."""

import pytest
import torch
from edit3r_model.gaussian_adapter import adapt
from edit3r_model.memory import estimate_bytes
from hypothesis import given, settings, strategies as st

import edit3r
from edit3r.contract.errors import (
    InputError,
    MissingDependencyError,
    RunError,
    SettingsError,
)
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Gaussians, Views
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.kit.geometry.rotations import covariances, quats_to_matrices

SIZES = {"width": 32, "depth": 1, "heads": 2}
SIZES |= {f"decoder_{name}": value for name, value in SIZES.items()}
BACKBONE = SIZES | {"decoder_depth": 4}
HEAD = {"feature_width": 8, "point_width": 8, "layer_widths": (8, 8, 8, 8)}
FIELDS = ("means", "scales", "quats", "opacities", "harmonics")


def build(**settings):
    given = {
        "weights": "random",
        "device": "cpu",
        "backbone": BACKBONE,
        "head": HEAD,
        **settings,
    }
    return edit3r.build("reconstructor", "noposplat", **given)


@pytest.fixture(scope="module")
def reconstructor():
    return build()


def views_of(images: torch.Tensor, fov_degrees: float = 60.0) -> Views:
    batch, count, _, height, width = images.shape
    fov = torch.deg2rad(torch.tensor(fov_degrees)).item()
    lens = intrinsics_from_fov(fov, (height, width))
    return Views(images, lens.repeat(batch, count, 1, 1))


def photos(*size: int) -> Views:
    generator = torch.Generator().manual_seed(0)
    return views_of(torch.rand(1, 2, 3, *size, generator=generator))


def require_valid(gaussians: Gaussians) -> None:
    for name in FIELDS:
        assert getattr(gaussians, name).isfinite().all(), name
    assert gaussians.opacities.min() >= 0 and gaussians.opacities.max() <= 1
    assert gaussians.scales.min() > 0 and gaussians.scales.max() <= 0.3
    assert quats_to_matrices(gaussians.quats).isfinite().all()
    assert covariances(gaussians.scales, gaussians.quats).isfinite().all()


CHECKS = (torch.arange(32)[:, None] + torch.arange(48)) % 2
IMAGES = {
    "black": torch.zeros(1, 2, 3, 32, 48),
    "white": torch.ones(1, 2, 3, 32, 48),
    "red": torch.tensor([1.0, 0, 0])[:, None, None].expand(1, 2, 3, 32, 48),
    "checks": CHECKS.float().expand(1, 2, 3, 32, 48),
    "identical": torch.rand(1, 1, 3, 32, 48).expand(1, 2, 3, 32, 48),
    "twelve views": torch.rand(1, 12, 3, 16, 16),
    "batch": torch.rand(3, 2, 3, 16, 32),
}


@pytest.mark.parametrize("images", IMAGES.values(), ids=IMAGES.keys())
def test_extreme_images_give_valid_gaussians(reconstructor, images):
    gaussians = reconstructor(views_of(images)).gaussians
    require_valid(gaussians)
    assert gaussians.count == images.shape[1] * images.shape[3] * images.shape[4]


@pytest.mark.parametrize("fov", [5, 150])
def test_extreme_fields_of_view_give_valid_gaussians(reconstructor, fov):
    require_valid(reconstructor(views_of(torch.rand(1, 2, 3, 32, 32), fov)).gaussians)


@settings(max_examples=12)
@given(
    points=st.floats(-80, 80, width=32),
    attributes=st.floats(-80, 80, width=32),
    dtype=st.sampled_from([torch.float16, torch.bfloat16, torch.float32]),
)
def test_raw_outputs_up_to_80_stay_bounded_with_finite_gradients(
    points, attributes, dtype
):
    shared = {"dtype": dtype, "requires_grad": True}
    raw = torch.full((1, 2, 3, 2, 2), points, **shared)
    parameters = torch.full((1, 2, 83, 2, 2), attributes, **shared)
    gaussians = adapt(raw, parameters, 0.001, 4)
    require_valid(gaussians)
    # A loss that is itself bounded, as float16 gradients must be.
    distance = gaussians.means.norm(dim=-1).log1p()
    (distance.mean() + gaussians.scales.sum() + gaussians.quats.sum()).backward()
    assert raw.grad.isfinite().all() and parameters.grad.isfinite().all()


def test_zero_quaternions_mean_no_rotation_and_have_finite_gradients():
    parameters = torch.zeros(1, 1, 83, 1, 1, requires_grad=True)
    gaussians = adapt(torch.zeros(1, 1, 3, 1, 1), parameters, 0.001, 4)
    assert torch.equal(quats_to_matrices(gaussians.quats)[0, 0], torch.eye(3))
    covariances(gaussians.scales, gaussians.quats).sum().backward()
    assert parameters.grad.isfinite().all()


@pytest.mark.slow
def test_gradients_reach_every_parameter_while_the_network_is_in_training_mode():
    reconstructor, views = build(), photos(32, 48)
    assert not reconstructor(views).gaussians.means.requires_grad
    reconstructor.network.train()
    gaussians = reconstructor(views).gaussians
    sum(getattr(gaussians, name).square().mean() for name in FIELDS).backward()
    for name, value in reconstructor.network.named_parameters():
        assert value.grad is not None and value.grad.isfinite().all(), name


@pytest.mark.slow
def test_dropout_counts_in_training_alone():
    plain, dropping = build(), build(head=HEAD | {"dropout": 0.5})
    opacities = [made(photos(16, 16)).gaussians.opacities for made in (plain, dropping)]
    assert torch.equal(*opacities)
    dropping.network.train()
    assert not torch.allclose(
        dropping(photos(16, 16)).gaussians.opacities, opacities[0]
    )


def test_one_view_is_an_error_that_asks_for_another(reconstructor):
    with pytest.raises(InputError, match="at least 2 views"):
        reconstructor(photos(32, 32).select([0]))


@pytest.mark.slow
@pytest.mark.parametrize("fit", ["resize", "pad"])
def test_any_image_size_comes_through(fit):
    reconstructor = build(fit=fit, resolution=48)
    for size in [(1, 1), (7, 150), (33, 17), (120, 90), (48, 48)]:
        gaussians = reconstructor(photos(*size)).gaussians
        require_valid(gaussians)
        assert (gaussians.view_index == 0).sum() * 2 == gaussians.count


def test_images_the_network_takes_as_they_are_are_not_touched(reconstructor):
    views = photos(48, 80)
    direct = reconstructor.network(views.images, views.intrinsics)
    assert torch.equal(reconstructor(views).gaussians.means, direct.means)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(16, 16), (80, 48)])
def test_every_precision_agrees_with_plain_layers(size, monkeypatch):
    monkeypatch.setattr("edit3r_model.engine.bfloat16_gain", lambda device: 2.0)
    wide = {"feature_width": 64, "point_width": 64, "layer_widths": (64, 64, 64, 64)}
    plain = build(head=wide)(photos(*size)).gaussians
    for precision, most in {"float32": 1e-5, "bfloat16": 0.01}.items():
        fast = build(precision=precision, head=wide)(photos(*size)).gaussians
        require_valid(fast)
        for name in ("means", "scales", "opacities", "harmonics"):
            expected = getattr(plain, name)
            gap = (getattr(fast, name) - expected).norm() / expected.norm()
            assert gap < most, (precision, name)


def test_without_weights_it_refuses_and_says_what_to_do():
    with pytest.raises(MissingDependencyError, match=r"reconstructor\.weights=FILE"):
        edit3r.build("reconstructor", "noposplat")


@pytest.mark.slow
def test_random_weights_are_said_aloud_and_follow_from_the_seed():
    with collecting(Report()) as report:
        made = [build(seed=seed).network.state_dict() for seed in (0, 0, 1)]
    first, second, other = (
        state["backbone.encoder.0.mlp.fc1.weight"] for state in made
    )
    assert torch.equal(first, second) and not torch.equal(first, other)
    assert any("random" in text for text in report.warnings)
    assert report.notes["reconstructor.weights"] == {"source": "random"}


def test_both_decoders_start_equal_and_the_heads_do_not(reconstructor):
    network = reconstructor.network
    one, two = network.backbone.decoders
    assert torch.equal(one[3].mlp.fc1.weight, two[3].mlp.fc1.weight)
    one, two = network.head.centres
    assert not torch.equal(one.out.weight, two.out.weight)


def test_harmonics_can_be_cut_to_what_the_published_rasterizer_shows(reconstructor):
    views = photos(16, 16)
    cut = build(head={**HEAD, "keep_degree": 3})(views).gaussians
    whole = reconstructor(views).gaussians.harmonics
    assert cut.degree == 3 and torch.equal(cut.harmonics, whole[:, :, :16])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"precision": "float16", "device": "cpu"}, "CUDA"),
        ({"precision": "float64"}, "float32"),
        ({"device": "gpu"}, r"reconstructor\.device: 'gpu' cannot be used"),
    ],
)
def test_what_the_device_does_not_run_is_an_error(wrong, words):
    with pytest.raises(SettingsError, match=words):
        build(**wrong)


def test_too_large_a_run_is_refused_before_it_starts(reconstructor, monkeypatch):
    monkeypatch.setattr("edit3r_model.memory.available_bytes", lambda device: 1000)
    with pytest.raises(RunError, match=r"lower reconstructor\.resolution"):
        reconstructor(photos(32, 32))


def test_running_out_of_memory_says_what_to_lower(reconstructor, monkeypatch):
    def exhausted(views):
        raise RuntimeError("[enforce fail] DefaultCPUAllocator: not enough memory")

    monkeypatch.setattr(reconstructor.network, "reconstruct", exhausted)
    words = r"out of memory while .* 32x32; lower reconstructor\.resolution"
    with pytest.raises(RunError, match=words):
        reconstructor(photos(32, 32))


def test_the_memory_estimate_grows_with_views_and_size(reconstructor):
    backbone = reconstructor.network.backbone
    base = estimate_bytes(backbone, 1, 2, (64, 64))
    assert estimate_bytes(backbone, 1, 4, (64, 64)) > base
    assert estimate_bytes(backbone, 1, 2, (128, 64)) > 1.5 * base
    assert estimate_bytes(backbone, 2, 2, (64, 64)) > base
