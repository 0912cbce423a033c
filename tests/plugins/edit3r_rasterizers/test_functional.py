"""The rasterizer as a function: what gsplat's documentation says of the same arguments."""

import math

import pytest
import torch
from edit3r_rasterizers.functional import RENDER_MODES, rasterization
from raster_scenes import cameras, cloud

import edit3r
from edit3r.contract.errors import InputError
from edit3r.kit.geometry.cameras import invert_rigid, to_pixels

WIDTH, HEIGHT = 31, 21
K = torch.tensor([[30.0, 0.0, 15.5], [0.0, 40.0, 10.5], [0.0, 0.0, 1.0]])
DEPTH = 2.5


def ball(**changes):
    """The arguments for a ball straight ahead."""
    return {
        "means": torch.tensor([[0.0, 0.0, DEPTH]]),
        "quats": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        "scales": torch.full((1, 3), 0.2),
        "opacities": torch.tensor([0.7]),
        "colors": torch.tensor([[0.9, 0.0, -2.5]]),
        "viewmats": torch.eye(4)[None],
        "Ks": K[None],
        "width": WIDTH,
        "height": HEIGHT,
    } | changes


def alpha_of_the_ball() -> torch.Tensor:
    """In closed form, [H, W]."""
    x = (torch.arange(WIDTH) + 0.5 - K[0, 2])[None]
    y = (torch.arange(HEIGHT) + 0.5 - K[1, 2])[:, None]
    variance_x = (0.2 * K[0, 0] / DEPTH) ** 2 + 0.3
    variance_y = (0.2 * K[1, 1] / DEPTH) ** 2 + 0.3
    alpha = 0.7 * torch.exp(-0.5 * (x**2 / variance_x + y**2 / variance_y))
    return torch.where(alpha >= 1 / 255, alpha, 0.0)


@pytest.mark.parametrize("mode", RENDER_MODES)
def test_one_gaussian_is_what_the_formula_says_in_every_mode(mode):
    alpha = alpha_of_the_ball()[None, ..., None]
    images, alphas, meta = rasterization(**ball(), render_mode=mode)
    colours = alpha * ball()["colors"]
    expected = {
        "RGB": [colours],
        "D": [alpha * DEPTH],
        "ED": [(alpha > 0) * DEPTH],
        "RGB+D": [colours, alpha * DEPTH],
        "RGB+ED": [colours, (alpha > 0) * DEPTH],
    }[mode]
    assert torch.allclose(images, torch.cat(expected, -1), atol=2e-6)
    assert torch.allclose(alphas, alpha, atol=1e-6)
    assert meta == {"width": WIDTH, "height": HEIGHT, "n_cameras": 1}


def test_each_camera_has_its_background_behind_what_is_drawn():
    twice = ball(viewmats=torch.eye(4).expand(2, 4, 4), Ks=K.expand(2, 3, 3))
    backgrounds = torch.tensor([[0.1, 0.2, 0.3], [1.0, 0.5, 0.0]])
    on_black, alphas, _ = rasterization(**twice)
    images, _, _ = rasterization(**twice, backgrounds=backgrounds, render_mode="RGB+D")
    behind = (1 - alphas) * backgrounds[:, None, None]
    assert torch.allclose(images[..., :3], on_black + behind, atol=1e-6)


def test_a_colour_of_zero_has_a_gradient():
    colors = torch.zeros(1, 3, requires_grad=True)
    images, alphas, _ = rasterization(**ball(colors=colors))
    images.sum().backward()
    assert torch.allclose(colors.grad, alphas.sum().expand(1, 3))


@pytest.mark.parametrize("sh_degree", [0, 2, 3])
def test_a_scene_looks_as_in_the_pipeline(sh_degree):
    scene, views = cloud(80, degree=3), cameras((40, 53), count=3)
    coefficients = (sh_degree + 1) ** 2
    named = ("means", "quats", "scales", "opacities")
    settings = {"near_plane": 2.5, "far_plane": 3.5, "eps2d": 0.5}
    images, alphas, _ = rasterization(
        **{name: getattr(scene, name)[0] for name in named},
        colors=scene.harmonics[0],
        viewmats=invert_rigid(views.c2w[0]),
        Ks=to_pixels(views.intrinsics[0], views.image_size),
        **{"width": 53, "height": 40} | settings,
        sh_degree=sh_degree,
        render_mode="RGB+ED",
    )
    scene.harmonics[:, :, coefficients:] = 0
    pipeline = edit3r.build("rasterizer", "numba", **settings)
    expected = pipeline.render(scene, views)
    both = torch.cat((expected.images, expected.depths), 2)[0]
    assert torch.allclose(images, both.movedim(1, -1), atol=1e-4)
    assert torch.allclose(alphas, expected.alphas[0].movedim(1, -1), atol=1e-5)


def test_no_gaussian_leaves_the_background():
    named = ("means", "quats", "scales", "opacities", "colors")
    nothing = {name: ball()[name][:0] for name in named}
    images, alphas, _ = rasterization(**ball(**nothing), backgrounds=torch.ones(1, 3))
    assert (images == 1).all() and not alphas.any()


def test_gradients_of_every_tensor_are_those_of_finite_differences():
    """Gaussians that cover the image, so that nowhere one begins or ends."""
    draw = torch.Generator().manual_seed(1)

    def normal(*shape):
        return torch.randn(*shape, generator=draw)

    count, size = 3, (2, 9, 12, 4)
    tensors = {
        "means": 0.3 * normal(count, 3) + torch.tensor([0.0, 0.0, 3.0]),
        "quats": normal(count, 4),
        "scales": 2 + normal(count, 3).abs(),
        "opacities": torch.tensor([0.5, 0.6, 0.4]),
        "colors": normal(count, 9, 3),
        "Ks": torch.tensor([[14.0, 0, 5], [0, 12, 4], [0, 0, 1]]).expand(2, 3, 3),
        "turns": 0.1 * normal(2, 6),
    }
    weights = normal(*size).double()

    def loss(turns, **tensors):
        rates = torch.zeros(2, 4, 4)
        rates[:, [2, 0, 1], [1, 2, 0]] = turns[:, :3]
        rates[:, [1, 2, 0], [2, 0, 1]] = -turns[:, :3]
        rates[:, :3, 3] = turns[:, 3:]
        images, _, _ = rasterization(
            **tensors,
            viewmats=torch.linalg.matrix_exp(rates),
            width=size[2],
            height=size[1],
            sh_degree=2,
            backgrounds=torch.tensor([[0.1, 0.4, 0.8]]).expand(2, 3),
            render_mode="RGB+ED",
        )
        return (images.double() * weights).sum()

    leaves = {name: value.clone().requires_grad_() for name, value in tensors.items()}
    loss(**leaves).backward()
    for name, value in tensors.items():
        direction = normal(*value.shape)
        if name == "Ks":
            direction[:, 2] = 0
        up, down = (
            loss(**tensors | {name: value + step * direction}).item()
            for step in (1e-2, -1e-2)
        )
        slope = (leaves[name].grad * direction).sum().item()
        assert slope == pytest.approx((up - down) / 2e-2, rel=1e-2), name


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"packed": True, "covars": None}, "gsplat's packed, covars is not available"),
        ({"render_mode": "N"}, "expected render_mode in .*, got 'N'"),
        ({"viewmats": 2 * torch.eye(4)[None]}, "viewmats must be rigid"),
        ({"colors": torch.zeros(1, 4, 3), "sh_degree": 2}, "2 needs 9 coefficients"),
        ({"Ks": -K[None]}, "focal lengths must be positive"),
        ({"opacities": torch.tensor([math.nan])}, r"opacities: 1 of 1 values"),
    ],
)
def test_what_it_cannot_do_is_refused_in_a_sentence(changes, message):
    with pytest.raises(InputError, match=message):
        rasterization(**ball(**changes))


@pytest.mark.parametrize("colors", [torch.zeros(1, 5), torch.zeros(1, 4, 3)])
def test_colours_of_another_shape_are_refused(colors):
    with pytest.raises(ValueError, match="expected shape"):
        rasterization(**ball(colors=colors))
