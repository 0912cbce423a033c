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
    scene = cloud(20_000, degree=1, scales=(0.005, 0.05))
    views = cameras((70, 90), count=2, dtype=torch.float64)
    one, several = (pictures(build(n), scene, views) for n in (1, threads))
    assert all(torch.equal(a, b) for a, b in zip(one, several))
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

    callers = [threading.Thread(target=call, args=(index,)) for index in range(6)]
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
    apart, whole = (build(1).render(x, views).images for x in (strided, scene))
    assert torch.equal(apart, whole)


def test_rendering_twice_before_one_backward_pass_keeps_both_graphs():
    rasterizer, views = build(1), cameras()
    means = cloud(40).means.clone().requires_grad_()

    def totals():
        for seed, moved in ((1, means), (0, means + 0.1)):
            scene = replace(cloud(40, seed=seed), means=moved)
            yield rasterizer.render(scene, views).images.sum()

    for total in totals():
        total.backward()
    apart, means.grad = means.grad, None
    sum(totals()).backward()
    assert torch.allclose(means.grad, apart, rtol=1e-5, atol=1e-5)


def test_colours_alone_get_the_same_gradient_as_with_all_else():
    scene, views, rasterizer = cloud(60, degree=1), cameras(count=3), build(1)
    colours = scene.harmonics.clone().requires_grad_()
    named = ("means", "scales", "quats", "opacities")
    every = {name: getattr(scene, name).clone().requires_grad_() for name in named}

    def gradient(**others):
        given = replace(scene, **others, harmonics=colours)
        total = rasterizer.render(given, views).images.sum()
        return torch.autograd.grad(total, colours)[0]

    alone = gradient()
    assert alone.any() and torch.equal(alone, gradient(**every))


def test_another_device_is_refused_with_the_way_out():
    said = "the Gaussians are on meta; use 'gsplat' or 'torch' there"
    with pytest.raises(InputError, match=said):
        build(1).render(cloud(5).to("meta"), cameras().to("meta"))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"far_plane": 0.005}, r"far_plane \(0.005\) must be above near_plane"),
        ({"background": (0.0, 2.0, 0.0)}, r"background\.1: .* less than or equal to 1"),
        ({"eps2d": 0.0}, "eps2d"),
        ({"max_alpha": 1.0}, "max_alpha"),
    ],
)
def test_settings_out_of_range_are_errors_that_name_them(changed, message):
    with pytest.raises(edit3r.Edit3rError, match=message):
        edit3r.build("rasterizer", "numba", **changed)


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
    digest = kernels._digest_of_sources()
    assert shade_tiles.py_func.__qualname__ == f"shade_tiles_{digest}"


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
    command = [sys.executable, "-c", COLD, differentiate_tiles._cache.cache_path]
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    assert int(subprocess.check_output(command, env=env, text=True)) == 0


def test_kept_kernels_start_no_process(monkeypatch):
    started = []
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: started.append(a))
    compile_ahead.main()
    NumbaRasterizer(NumbaSettings()).prepare("cpu")
    assert not started
