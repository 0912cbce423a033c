import os
import subprocess
import sys
import threading
from dataclasses import replace

import pytest
import torch
from edit3r_rasterizers import compile_ahead, kernels
from edit3r_rasterizers.compositing import differentiate_tiles, shade_tiles
from edit3r_rasterizers.kernels import even_bounds, run_slices
from edit3r_rasterizers.numba_rasterizer import NumbaRasterizer, NumbaSettings
from edit3r_rasterizers.settings import RasterizerSettings
from raster_scenes import cameras, cloud, gradients, one

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting

WHITE = torch.ones(3)


def build(threads: int):
    return edit3r.build("rasterizer", "numba", threads=threads)


def pictures(rasterizer, scene, views):
    rendering = rasterizer.render(scene, views)
    return rendering.images, rendering.alphas, rendering.depths


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_the_same_bits_for_any_number_of_threads_forward_and_backward(threads):
    scene, views = (
        cloud(20_000, degree=1, scales=(0.005, 0.05)),
        cameras((70, 90), count=2, dtype=torch.float64),
    )
    for a, b in zip(
        pictures(build(1), scene, views), pictures(build(threads), scene, views)
    ):
        assert torch.equal(a, b)
    alone, shared = (gradients(build(n), scene, views, WHITE) for n in (1, threads))
    for name in alone:
        assert torch.equal(alone[name], shared[name]), name


def test_many_callers_at_once_get_what_one_gets():
    rasterizer, views = build(2), cameras((70, 90))
    scenes = [cloud(9_000, seed=seed) for seed in range(6)]
    expected = [rasterizer.render(scene, views).images for scene in scenes]
    found = [None] * len(scenes)

    def call(index):
        found[index] = rasterizer.render(scenes[index], views).images

    callers = [
        threading.Thread(target=call, args=(index,)) for index in range(len(scenes))
    ]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert all(torch.equal(a, b) for a, b in zip(expected, found))


def test_slices_cover_every_element_once():
    for count in (0, 1, 5_000, 100_001):
        bounds = even_bounds(count, threads=3)
        assert bounds[0] == 0 and bounds[-1] == count and bounds == sorted(bounds)
    seen = run_slices(lambda first, last: list(range(first, last)), [0, 3, 3, 7, 10], 2)
    assert [k for part in seen for k in part] == list(range(10))


def test_inputs_need_not_be_contiguous():
    scene, views = cloud(50, degree=1), cameras()
    strided = replace(
        scene,
        means=scene.means.flip(1).flip(1).transpose(1, 2).contiguous().transpose(1, 2),
        harmonics=torch.stack((scene.harmonics, scene.harmonics), -1)[..., 0],
    )
    assert not strided.means.is_contiguous() and not strided.harmonics.is_contiguous()
    assert torch.equal(
        build(1).render(strided, views).images, build(1).render(scene, views).images
    )


def test_rendering_twice_before_one_backward_pass_keeps_both_graphs():
    rasterizer, views = build(1), cameras()
    means = cloud(40).means.clone().requires_grad_()
    scenes = [
        replace(cloud(40), means=means),
        replace(cloud(40, seed=0), means=means + 0.1),
    ]
    for scene in scenes:
        rasterizer.render(scene, views).images.sum().backward()
    apart, means.grad = means.grad, None
    scenes = [
        replace(cloud(40), means=means),
        replace(cloud(40, seed=0), means=means + 0.1),
    ]
    sum(rasterizer.render(scene, views).images.sum() for scene in scenes).backward()
    assert torch.allclose(means.grad, apart, rtol=1e-5, atol=1e-5)


def test_colours_alone_get_the_same_gradient_as_with_all_else():
    scene, views, rasterizer = cloud(60, degree=1), cameras(count=3), build(1)
    colours = scene.harmonics.clone().requires_grad_()
    every = {
        name: getattr(scene, name).clone().requires_grad_()
        for name in ("means", "scales", "quats", "opacities")
    }
    alone, beside = (
        torch.autograd.grad(
            rasterizer.render(
                replace(scene, **others, harmonics=colours), views
            ).images.sum(),
            colours,
        )
        for others in ({}, every)
    )
    assert torch.equal(*alone, *beside) and alone[0].any()


def test_no_gradient_memory_is_kept_without_gradients():
    rendering = build(1).render(cloud(10), cameras())
    assert rendering.images.grad_fn is None


def test_another_device_is_refused_with_the_way_out():
    with pytest.raises(
        InputError, match="the Gaussians are on meta; use 'gsplat' or 'torch' there"
    ):
        build(1).render(cloud(5).to("meta"), cameras().to("meta"))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"far_plane": 0.005},
            r"far_plane \(0.005\) must be above near_plane \(0.01\)",
        ),
        (
            {"background": (0.0, 2.0, 0.0)},
            r"rasterizer\.background\.1: .* less than or equal to 1",
        ),
        ({"eps2d": 0.0}, "eps2d"),
        ({"max_alpha": 1.0}, "max_alpha"),
    ],
)
def test_settings_out_of_range_are_errors_that_name_them(changed, message):
    with pytest.raises(edit3r.Edit3rError, match=message):
        edit3r.build("rasterizer", "numba", **changed)


def test_the_defaults_are_the_stated_convention():
    defaults = RasterizerSettings().model_dump()
    assert defaults == {
        "near_plane": None,
        "far_plane": 1e30,
        "background": (0.0, 0.0, 0.0),
        "eps2d": 0.3,
        "max_alpha": 0.999,
        "min_alpha": 1 / 255,
        "min_transmittance": 1e-4,
    }


@pytest.mark.parametrize(
    ("scale", "expected"), [(1, 0.01), (0.4, 0.01), (0.1, 0.0025), (1e-5, 0.01 / 2**15)]
)
def test_the_near_plane_follows_small_scenes_and_no_others(scale, expected):
    scene = cloud(300)
    small = replace(scene, means=scene.means * scale)
    settings = RasterizerSettings()
    assert settings.near_planes(small) == [expected]
    assert RasterizerSettings(near_plane=0.02).near_planes(small) == [0.02]
    far_away = replace(small, means=small.means + 5)
    assert settings.near_planes(far_away)[0] / expected in (0.5, 1, 2)


def test_scenes_without_a_size_have_the_usual_near_plane():
    settings = RasterizerSettings()
    assert settings.near_planes(one()) == [0.01]
    assert settings.near_planes(cloud(0)) == [0.01]
    broken = replace(cloud(5), means=torch.full((1, 5, 3), torch.nan))
    assert settings.near_planes(broken) == [0.01]
    sky = cloud(300).means.clone() * 0.01
    sky[0, :20] = 1e20  # a few that are far away are not its size
    assert settings.near_planes(replace(cloud(300), means=sky))[0] < 0.001


def test_kernels_without_a_cache_folder_still_run_and_say_so(monkeypatch):
    monkeypatch.setattr("numba.core.caching.CacheImpl._locator_classes", [])
    doubled = kernels.kernel(lambda x: 2 * x)
    with collecting(Report()) as report:
        assert doubled(21) == 42
    assert "NUMBA_CACHE_DIR" in report.warnings[0]


def test_a_kernel_is_named_after_all_sources_so_that_no_stale_one_is_run():
    assert (
        shade_tiles.py_func.__qualname__
        == f"shade_tiles_{kernels._digest_of_sources()}"
    )


COLD = """
import shutil, sys
from numba.core import event
compiled = []

class Listener(event.Listener):
    def on_start(self, started):
        compiled.append(started.data["dispatcher"].py_func.__name__)

    def on_end(self, ended):
        pass

event.register("numba:compile", Listener())
from edit3r_rasterizers import compile_ahead
from edit3r_rasterizers.compositing import differentiate_tiles
from edit3r_rasterizers.numba_rasterizer import NumbaRasterizer, NumbaSettings

missing = shutil.ignore_patterns("*.differentiate_tiles_*")
folder = differentiate_tiles._cache.cache_path
shutil.copytree(sys.argv[1], folder, ignore=missing, dirs_exist_ok=True)
NumbaRasterizer(NumbaSettings()).prepare("cpu")
compile_ahead.main()
before = len(compiled)
from edit3r.kit.compute.compiling import compiled as decorated
decorated(nogil=True)(lambda value: value + 1)(1)
assert len(compiled) == before + 1, "nobody counts"
print(before)
"""


@pytest.mark.slow
def test_a_first_run_compiles_no_kernel_itself(tmp_path):
    """All that an image and its gradient need is compiled and kept by the process beside it.

    Of the kernels the largest alone is compiled anew; one that could not be kept would be, too.
    """
    compile_ahead.main()
    kept = differentiate_tiles._cache.cache_path
    done = subprocess.run(
        [sys.executable, "-c", COLD, kept],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(done.stdout) == 0


def test_kept_kernels_start_no_process(monkeypatch):
    started = []
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: started.append(a))
    compile_ahead.main()
    NumbaRasterizer(NumbaSettings()).prepare("cpu")
    assert not started
