"""Scenes at the ends of what is possible: exact where a float64 renderer can say, always finite,
gradients too.
"""

import itertools
import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings, strategies as st
from raster_scenes import (
    assert_finite,
    assert_matches_naive,
    cameras,
    cloud,
    gradients,
    one,
)

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras, Gaussians

RASTERIZERS = {name: edit3r.build("rasterizer", name) for name in ("numba", "torch")}
NUMBA = RASTERIZERS["numba"]
WHITE = torch.ones(3)


@pytest.fixture(params=sorted(RASTERIZERS))
def rasterizer(request):
    return RASTERIZERS[request.param]


def assert_gradients_finite(rasterizer, scene, views):
    for name, gradient in gradients(rasterizer, scene, views, WHITE).items():
        assert torch.isfinite(gradient).all(), name


def check(rasterizer, scene, views, tolerance=2e-5, most_fragile=0.2):
    shown = rasterizer.render(scene, views)
    assert_matches_naive(shown, scene, views, tolerance, most_fragile)
    assert_gradients_finite(rasterizer, scene, views)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_needles_of_ratio_ten_thousand(rasterizer, seed):
    scene = cloud(40, seed=seed)
    long = torch.tensor([1.0, 1e-4, 1e-4]) * (0.2 + scene.opacities[..., None])
    needles = replace(scene, scales=long)
    check(rasterizer, needles, cameras((70, 90)), tolerance=1e-4)


def beside_the_picture():
    places = itertools.product((-5.0, 3.0), (-4.0, 0.5, 5.0))
    return [one(means=[x, y, 2.0], scales=[1.0, 0.4, 0.2]) for x, y in places]


def far_away():
    scene, views = cloud(60), cameras(count=2)
    shift, c2w = torch.tensor([1e4, -1e4, 1e4]), views.c2w.clone()
    c2w[..., :3, 3] += shift
    return replace(scene, means=scene.means + shift), replace(views, c2w=c2w)


TURNED = {"scales": [3.0, 3e-4, 3e-4], "quats": [math.cos(0.3), 0, 0, math.sin(0.3)]}
WILD = cloud(40, degree=2)
EXTREMES = {
    "needle from far outside": (
        one(means=[-4.0, -3.0, 2.0], **TURNED),
        cameras((150, 200)),
        1e-4,
    ),
    "covers the screen": (one(scales=[50.0, 50.0, 0.1]), cameras()),
    "smaller than pixels": (cloud(200, scales=(1e-6, 1e-5)), cameras()),
    "beside the picture": (Gaussians.cat(beside_the_picture()), cameras()),
    "with its camera 10,000 away": far_away(),
    "10,000 in front": (
        one(means=[100.0, -200.0, 1e4], scales=[300.0, 100.0, 10.0]),
        cameras(),
    ),
    "colours out of range": (replace(WILD, harmonics=WILD.harmonics * 1e6), cameras()),
    **{
        f"scale {x:g}": (one(scales=[x, 0.5 * x, 2 * x]), cameras(), 2e-5, 0.5)
        for x in (1e-8, 1e-4, 1e2, 1e4)
    },
    **{
        f"picture {size}": (cloud(60), cameras(size), 2e-5, 1.0)
        for size in [(1, 1), (1, 40), (17, 1), (16, 16), (17, 33), (15, 31), (5, 2)]
    },
}


@pytest.mark.parametrize("name", EXTREMES)
def test_what_is_extreme_agrees_with_the_naive_renderer(rasterizer, name):
    check(rasterizer, *EXTREMES[name])


def test_gaussians_at_and_behind_the_near_plane(rasterizer):
    depths = [-3.0, -0.01, 0.0, 0.00999, 0.0100001, 0.02, 0.5]
    parts = [
        one(means=[0.002 * k, 0.001, z], scales=[0.003] * 3)
        for k, z in enumerate(depths)
    ]
    scene = Gaussians.cat(parts)
    seen = scene.select(torch.tensor([4, 5, 6]))
    every, alone = (rasterizer.render(x, cameras()).images for x in (scene, seen))
    assert torch.equal(every, alone)
    check(rasterizer, scene, cameras())


def in_unit(scene, views, unit):
    moved = Cameras(views.c2w.clone(), views.intrinsics, views.image_size)
    moved.c2w[..., :3, 3] *= unit
    return replace(scene, means=scene.means * unit, scales=scene.scales * unit), moved


@pytest.mark.parametrize("unit", [2.0**-80, 2.0**-30, 2.0**-9, 2.0**20, 1e10, 1e28])
def test_a_scene_in_another_unit_looks_the_same(rasterizer, unit):
    scene, views = cloud(80), cameras((24, 31), count=2)
    expected = rasterizer.render(scene, views)
    moved = in_unit(scene, views, unit)
    shown = rasterizer.render(*moved)
    assert float(expected.alphas.max()) > 0.5
    assert torch.allclose(shown.images, expected.images, atol=1e-5)
    assert torch.allclose(shown.depths / unit, expected.depths, atol=1e-4)
    assert_gradients_finite(rasterizer, *moved)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_scenes_of_a_batch_are_drawn_as_each_alone_whatever_their_units(
    rasterizer, dtype
):
    usual, views = cloud(60, dtype=dtype), cameras((24, 31), count=2, dtype=dtype)
    few = cloud(7, dtype=dtype)  # filled up with transparent ones in the batch
    alone = [
        in_unit(scene, views, unit)
        for scene in (usual, few)
        for unit in (1.0, 1e-4, 1e6, 1e12)
    ]
    c2w = torch.cat([seen.c2w for _, seen in alone])
    lenses = views.intrinsics.expand(len(alone), -1, -1, -1)
    scenes = Gaussians.stack(scene for scene, _ in alone)
    batch = rasterizer.render(scenes, replace(views, c2w=c2w, intrinsics=lenses))
    for index, (scene, seen) in enumerate(alone):
        expected = rasterizer.render(scene, seen)
        assert float(expected.alphas.max()) > 0.5
        assert_matches_naive(expected, scene, seen, near_plane=0, far_plane=math.inf)
        for name in ("images", "alphas", "depths"):
            shown = getattr(batch, name)[index : index + 1]
            assert torch.equal(shown, getattr(expected, name)), (index, name)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_refused_with_the_way_out(rasterizer, dtype):
    with pytest.raises(InputError, match=r"got b?float16.*\.to\(torch.float32\)"):
        rasterizer.render(cloud(5, dtype=dtype), cameras())


@pytest.mark.parametrize("opacity", [0.0, 1 / 300, 1.0])
def test_opacity_of_zero_hides_nothing_and_of_one_hides_almost_all(rasterizer, opacity):
    scene = one(opacities=opacity, scales=[5.0, 5.0, 0.1])
    check(rasterizer, scene, cameras())
    alpha = rasterizer.render(scene, cameras((1, 1))).alphas.item()
    assert alpha == pytest.approx(0.999 if opacity == 1 else 0.0, abs=1e-6)


@pytest.mark.parametrize("norm", [1e-3, 1e3])
def test_the_norm_of_a_quaternion_does_not_matter(rasterizer, norm):
    scene = cloud(30)
    scaled = replace(scene, quats=scene.quats * norm)
    plain, other = (rasterizer.render(x, cameras()).images for x in (scene, scaled))
    assert torch.allclose(other, plain, atol=1e-5)
    check(rasterizer, scaled, cameras())


def test_a_zero_quaternion_is_the_identity_with_zero_gradient(rasterizer):
    identity = one(scales=[0.3, 0.1, 0.1])
    zero = replace(identity, quats=torch.zeros(1, 1, 4))
    pictures = [rasterizer.render(x, cameras()).images for x in (zero, identity)]
    assert torch.equal(*pictures)
    assert not gradients(rasterizer, zero, cameras(), WHITE)["quats"].any()


def test_identical_depths_are_drawn_in_index_order(rasterizer):
    red, blue = one(harmonics=[[3.0, -3.0, -3.0]]), one(harmonics=[[-3.0, -3.0, 3.0]])
    for first, second in ((red, blue), (blue, red)):
        scene = Gaussians.cat([first, second])
        check(rasterizer, scene, cameras())
        brightest = rasterizer.render(scene, cameras()).images.amax((0, 1, 3, 4))
        assert (brightest[0] > brightest[2]) == (first is red)


@pytest.mark.parametrize("fov", [math.radians(0.05), math.radians(179)])
def test_very_long_and_very_short_focal_lengths(rasterizer, fov):
    scene = cloud(60)
    if fov < 1:
        means = scene.means * torch.tensor([1e-3, 1e-3, 1.0])
        scene = replace(scene, means=means, scales=scene.scales * 1e-3)
    check(rasterizer, scene, cameras(fov=fov))


def test_one_gaussian_and_none(rasterizer):
    check(rasterizer, one(), cameras())
    none, behind = cloud(0, degree=1), torch.tensor([0.2, 0.5, 0.8])
    rendering = rasterizer.render(none, cameras(), behind)
    assert torch.allclose(rendering.images.amax((-1, -2)), behind)
    assert rendering.alphas.abs().max() == 0 and rendering.depths.abs().max() == 0
    assert_gradients_finite(rasterizer, none, cameras())


def test_no_camera_and_no_scene(rasterizer):
    views = cameras()
    empty = Cameras(views.c2w[:, :0], views.intrinsics[:, :0], views.image_size)
    assert rasterizer.render(cloud(5), empty).images.shape == (1, 0, 3, 40, 53)
    empty = Cameras(views.c2w[:0], views.intrinsics[:0], views.image_size)
    assert rasterizer.render(cloud(5, batch=0), empty).images.shape == (0, 1, 3, 40, 53)


def test_the_largest_floats_make_no_infinite_picture(rasterizer):
    huge = torch.finfo(torch.float32).max
    scene = cloud(20, degree=1)
    wild = replace(scene, harmonics=scene.harmonics.sign() * huge)
    sizes = {"scales": 3, "means": 3, "quats": 4}
    far = [one(**{name: [huge] * size}) for name, size in sizes.items()]
    for scene in (wild, *far):
        assert_finite(rasterizer.render(scene, cameras()))


finite = {"allow_nan": False, "allow_infinity": False, "width": 32}


@pytest.mark.slow
@settings(max_examples=80)
@given(
    position=st.tuples(*[st.floats(-1e4, 1e4, **finite)] * 3),
    scales=st.tuples(*[st.floats(-8, 4, **finite)] * 3),
    quat=st.tuples(*[st.floats(-1e3, 1e3, **finite)] * 4),
    opacity=st.floats(0, 1, **finite),
    colour=st.tuples(*[st.floats(-1e4, 1e4, **finite)] * 3),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    fov=st.floats(0.001, 3.1),
)
def test_any_gaussian_gives_finite_pictures_and_gradients(
    position, scales, quat, opacity, colour, size, fov
):
    sizes, colours = [10.0**s for s in scales], [list(colour)]
    given = {"means": list(position), "scales": sizes, "quats": list(quat)}
    scene = one(**given, opacities=opacity, harmonics=colours)
    views = cameras(size, fov=fov)
    rendering = NUMBA.render(scene, views)
    assert_finite(rendering)
    assert rendering.alphas.min() >= 0 and rendering.alphas.max() <= 0.9991
    assert_gradients_finite(NUMBA, scene, views)


@pytest.mark.slow
@settings(max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    spread=st.floats(-3, 0.5),
    ratio=st.floats(-2, 0),
    degree=st.integers(0, 4),
)
def test_any_cloud_agrees_with_the_naive_renderer(seed, spread, ratio, degree):
    scene = cloud(25, degree, seed, scales=(10 ** (spread + ratio), 10**spread))
    views = cameras((23, 37))
    shown = NUMBA.render(scene, views)
    assert_matches_naive(shown, scene, views, tolerance=4e-5, most_fragile=1.0)


@pytest.mark.parametrize("name", ["means", "scales", "quats", "opacities", "harmonics"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_input_that_is_not_finite_names_the_field_and_how_many(rasterizer, name, value):
    scene = cloud(50, degree=1)
    getattr(scene, name).view(-1)[[3, 17]] = value
    total = getattr(scene, name).numel()
    said = rf"Gaussians\.{name}: 2 of {total} values are not finite"
    with pytest.raises(InputError, match=said):
        rasterizer.render(scene, cameras())


def test_what_is_not_finite_is_found_behind_the_camera_too(rasterizer):
    scene = one(means=[0.0, 0.0, -5.0], harmonics=[[0.1, math.nan, 0.1]])
    with pytest.raises(InputError, match=r"harmonics: 1 of 3 values is not finite"):
        rasterizer.render(scene, cameras())


def test_cameras_that_are_not_finite_or_see_nothing_are_refused(rasterizer):
    views = cameras(count=2)
    broken = Cameras(views.c2w.clone(), views.intrinsics.clone(), views.image_size)
    broken.c2w[0, 1, 0, 3] = math.nan
    with pytest.raises(InputError, match=r"Cameras\.c2w: 1 of 32 values is not finite"):
        rasterizer.render(cloud(5), broken)
    flat = Cameras(views.c2w, views.intrinsics.clone(), views.image_size)
    flat.intrinsics[0, 0, 1, 1] = 0
    with pytest.raises(InputError, match="focal lengths must be positive, got 0"):
        rasterizer.render(cloud(5), flat)
    with pytest.raises(InputError, match="cameras for 1 scenes, but Gaussians of 2"):
        rasterizer.render(cloud(5, batch=2), views)
    said = r"background: expected a shape that fits \[1, 2, 3\], got \[4\]"
    with pytest.raises(InputError, match=said):
        rasterizer.render(cloud(5), views, torch.zeros(4))


@pytest.mark.slow
def test_four_million_gaussians():
    draw = torch.Generator().manual_seed(0)
    count = 4_000_000
    sides, corner = torch.tensor([[3.0, 3.0, 2.0], [1.5, 1.5, -2.0]])
    means = torch.rand(1, count, 3, generator=draw) * sides - corner
    scales = torch.full((1, 1, 3), 1e-3).expand(1, count, 3).contiguous()
    quats = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(1, count, 4).contiguous()
    colours = torch.zeros(1, count, 1, 3)
    scene = Gaussians(means, scales, quats, torch.full((1, count), 0.3), colours)
    rendering = NUMBA.render(scene, cameras((64, 64)))
    assert_finite(rendering)
    grey = 0.5 * rendering.alphas.expand_as(rendering.images)
    assert torch.allclose(rendering.images, grey, atol=1e-4)
