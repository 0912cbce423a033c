import sys
import types
from dataclasses import replace

import pytest
import torch
from edit3r_rasterizers import gsplat_rasterizer
from edit3r_rasterizers.auto_rasterizer import choose
from edit3r_rasterizers.gsplat_rasterizer import GsplatRasterizer
from raster_scenes import cameras, cloud

import edit3r
from edit3r.contract.component import Component, Offer
from edit3r.contract.errors import InputError, MissingDependencyError, SettingsError
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Gaussians
from edit3r.loading.load import LoadedPlugins
from edit3r.loading.registry import Registry


class DepthsAlone(Rasterizer):
    gives = ("depths",)


def made_for(name, *devices, requires=()):
    """`depths` gives no images."""
    target = "edit3r_rasterizers.torch_rasterizer:TorchRasterizer"
    if name == "depths":
        target = f"{__name__}:DepthsAlone"
    needs = {"requires": requires, "devices": devices}
    component = Component(name, target, "a rasterizer", **needs)
    return Offer("rasterizer", component, "plugin", "1")


@pytest.mark.parametrize(
    ("device", "name", "reason"),
    [
        ("cpu", "numba", "made for cpu"),
        ("cuda", "gsplat", "made for cuda"),
        ("mps", "numba", "copied to the CPU"),
        ("xpu", "strangers", "made for xpu"),
    ],
)
def test_auto_picks_by_declared_devices_among_all_that_is_installed(
    device, name, reason
):
    offers = (
        made_for("anywhere"),
        made_for("gsplat", "cuda"),
        made_for("not-here", "mps", requires=("no_such_module",)),
        made_for("depths", "cpu"),
        made_for("numba", "cpu"),
        made_for("strangers", "xpu"),
    )
    offer, why = choose(Registry(LoadedPlugins(offers, ())), device)
    assert offer.component.name == name and reason in why


def test_auto_notes_its_choice_in_the_run_and_renders_like_it():
    scene, views = cloud(30), cameras()
    with collecting(Report()) as report:
        found = edit3r.build("rasterizer", "auto", eps2d=0.5).render(scene, views)
    assert report.notes["rasterizer.picked"] == "numba"
    assert report.notes["rasterizer.reason"] == "made for cpu, where the Gaussians are"
    numba = edit3r.build("rasterizer", "numba", eps2d=0.5)
    assert torch.equal(found.images, numba.render(scene, views).images)


def test_gsplat_without_cuda_says_what_to_use_instead(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    said = r"'gsplat' (runs on|needs an NVIDIA GPU with) "
    with pytest.raises(MissingDependencyError, match=said):
        edit3r.build("rasterizer", "gsplat")


def test_gsplat_with_cuda_but_not_installed_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r'pip install "edit3r\[gsplat\]"'):
        GsplatRasterizer(GsplatRasterizer.Settings())


def test_gsplat_refuses_settings_its_kernels_cannot_follow(monkeypatch):
    _pretend_cuda(monkeypatch)
    said = r"max_alpha: gsplat's kernels have 0\.999 built in, got 0.5"
    with pytest.raises(SettingsError, match=said):
        GsplatRasterizer(GsplatRasterizer.Settings(max_alpha=0.5))


def test_gsplat_refuses_gaussians_on_the_cpu(monkeypatch):
    _pretend_cuda(monkeypatch)
    with pytest.raises(InputError, match="the Gaussians are on cpu"):
        GsplatRasterizer(GsplatRasterizer.Settings()).render(cloud(3), cameras())


def test_gsplat_is_called_in_its_own_conventions(monkeypatch):
    calls = []

    def rasterization(**arguments):
        calls.append(arguments)
        shape = (len(arguments["viewmats"]), arguments["height"], arguments["width"])
        return torch.full((*shape, 4), 0.25), torch.full((*shape, 1), 0.5), {}

    _pretend_cuda(monkeypatch, rasterization)
    scene, views = cloud(7, degree=2, batch=2), cameras((20, 30), count=3, batch=2)
    rasterizer = GsplatRasterizer(GsplatRasterizer.Settings(background=(1, 0, 0)))
    colours, alphas, depths = rasterizer._render_scene(scene, views, 1, near=0.5)
    assert colours.shape == (3, 3, 20, 30)
    assert alphas.shape == depths.shape == (3, 1, 20, 30)
    (given,) = calls
    identity = given["viewmats"] @ views.c2w[1]
    assert torch.allclose(identity, torch.eye(4).expand(3, 4, 4), atol=1e-6)
    assert given["Ks"][0, 0, 2] == 15 and given["Ks"][0, 1, 2] == 10
    assert given["sh_degree"] == 2 and given["near_plane"] == 0.5
    assert given["colors"].shape == (7, 9, 3)
    assert torch.allclose(given["quats"].norm(dim=-1), torch.ones(7))


def test_gsplat_gets_each_scene_s_own_near_plane(monkeypatch):
    planes = []

    def rasterization(**arguments):
        planes.append((arguments["near_plane"], arguments["far_plane"]))
        return torch.zeros(1, 20, 30, 4), torch.zeros(1, 20, 30, 1), {}

    _pretend_cuda(monkeypatch, rasterization)
    monkeypatch.setattr(gsplat_rasterizer, "_check_device", lambda gaussians: None)
    small = cloud(9)
    small = replace(small, means=small.means * 2.0**-10)
    scene = Gaussians.stack([cloud(9), small])
    views = cameras((20, 30), batch=2)
    GsplatRasterizer(GsplatRasterizer.Settings()).render(scene, views)
    (near, far), (near_of_small, far_of_small) = planes
    assert near == 0.01 and near_of_small < 1e-4
    assert far == far_of_small == 1e30


def _pretend_cuda(monkeypatch, rasterization=None):
    """A stand-in for gsplat, so that what is handed to it can be looked at on any machine."""
    module = types.ModuleType("gsplat")
    module.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", module)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: module)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU")
def test_gsplat_agrees_with_numba():
    pytest.importorskip("gsplat")
    scene, views = cloud(200, degree=3), cameras((70, 90), count=2)
    truth = edit3r.build("rasterizer", "numba").render(scene, views)
    found = (
        edit3r.build("rasterizer", "gsplat")
        .render(scene.to("cuda"), views.to("cuda"))
        .to("cpu")
    )
    assert torch.allclose(found.images, truth.images, atol=2e-3)
    assert torch.allclose(found.alphas, truth.alphas, atol=2e-3)
