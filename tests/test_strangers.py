"""What a stranger brings is a full part: small plugins that use what first-party ones do not."""

from pathlib import Path

import pytest
import torch
from edit3r_rasterizers.torch_rasterizer import TorchRasterizer

import edit3r
from edit3r.contract.errors import PluginError, SettingsError
from edit3r.contract.interfaces import TrainingJob
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Cameras, Views
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.kit.rendering import render_each
from edit3r.kit.scenes.ply import load_ply, save_ply
from edit3r.loading.load import load_plugins
from edit3r.loading.registry import Registry
from edit3r_testing import (
    BackboneContract,
    HeadContract,
    LossContract,
    RasterizerContract,
    TinyBackbone,
    cameras_around,
    gaussian_cloud,
)

FOLDER = Path(__file__).parent / "strangers"
SMALL_DPT = {
    "feature_width": 8,
    "point_width": 8,
    "layer_widths": (4, 4, 8, 8),
    "harmonics_degree": 1,
}


@pytest.fixture(scope="module")
def registry() -> Registry:
    """Everything installed, and all strangers."""
    return Registry(load_plugins(tuple(sorted(FOLDER.glob("*.py")))))


def six_levels():
    return TinyBackbone(patch_size=14, feature_widths=(8, 12, 16, 20, 24, 28))


def single_pass(registry, head="layers", backbone="poses", **settings):
    parts = {"backbone": backbone, "head": head, "weights": "untrained"}
    return registry.build("reconstructor", "edit3r", **parts, **settings)


def views(size=(40, 52), count=2):
    images = torch.rand(1, count, 3, *size, generator=torch.Generator().manual_seed(0))
    lens = intrinsics_from_fov(1.0, size).expand(1, count, 3, 3)
    return Views(images, lens)


class TestThreeGaussiansAPixel(HeadContract):
    component, plugin_files = "layers", (FOLDER / "layers.py",)


class TestABackboneWithPoses(BackboneContract):
    component, plugin_files = "poses", (FOLDER / "posed_backbone.py",)


class TestDepthsAlone(RasterizerContract):
    component, plugin_files = "depths", (FOLDER / "depths.py",)


class TestTwoRenders(LossContract):
    component, plugin_files = "two-renders", (FOLDER / "two_renders.py",)


class TestSurfels(HeadContract):
    component, plugin_files = "surfels", (FOLDER / "surfels.py",)


class TestTheDptHeadOnPatchesOf14(HeadContract):
    """And on six levels, as DINOv2 has more than four."""

    component, settings = "dpt-gaussian", SMALL_DPT

    def make_backbone(self):
        return six_levels()


def test_three_gaussians_a_pixel_lose_those_of_the_padding_alone(registry):
    made = single_pass(registry, fit="pad")(views())
    assert made.per_pixel == 3 and made.gaussians.count == 3 * 2 * 40 * 52
    means = made.gaussians.means.unflatten(1, (2, 40, 52, 3))
    x, y, z = means[:, 0].unbind(-1)
    # Those of one pixel lie on its ray; the outermost pixels' rays are the photo's borders.
    assert torch.allclose(x[..., 0] / z[..., 0], x[..., 2] / z[..., 2], atol=1e-5)
    right, low = (x / z)[0, 0, -1, 0], (y / z)[0, -1, 0, 0]
    half = 0.5 / views().intrinsics[0, 0].diagonal()[:2]
    assert float(right / half[0]) == pytest.approx(1 - 1 / 52, abs=1e-4)
    assert float(low / half[1]) == pytest.approx(1 - 1 / 40, abs=1e-4)


def test_without_pixels_padding_is_refused_before_any_work(registry, monkeypatch):
    registry.load_class(registry.find("head", "layers"))
    import layers

    monkeypatch.setattr(layers.LayersHead, "per_pixel", 0)
    with pytest.raises(SettingsError, match="not make its Gaussians pixel by pixel"):
        single_pass(registry, fit="pad")
    assert single_pass(registry)(views()).per_pixel == 0


class Counted(TorchRasterizer):
    count = 0

    def render(self, *given):
        Counted.count += 1
        return super().render(*given)


def trained(registry, tmp_path, losses, **settings):
    """How far the head's weights moved in three steps on padded photos."""
    torch.manual_seed(0)
    network = single_pass(registry, fit="pad")
    data = edit3r.build(
        "dataset", "procedural", image_size=36, scenes=2, targets=1, textures=8
    )
    job = TrainingJob(
        network,
        edit3r.build("matcher", "classical"),
        Counted(Counted.Settings()),
        train_data=data,
        validation_data=data,
        losses={name: (1.0, registry.build("loss", name)) for name in losses},
        out=tmp_path,
    )
    weight = network.network.head.out.weight
    before = weight.detach().clone()
    settings = {"steps": 3, "batch": 1, "warmup": 1, "lr": 0.01, **settings}
    assert edit3r.build("trainer", "recolor", **settings).train(job).is_dir()
    return float((weight - before).detach().abs().max())


def test_three_gaussians_a_pixel_are_trained_on_padded_photos(registry, tmp_path):
    assert trained(registry, tmp_path, ("mse", "center")) > 0


def test_a_loss_of_two_renders_trains_by_itself(registry, tmp_path):
    alone, before = {"colour": 0, "depth": 0, "opacity": 0}, Counted.count
    assert trained(registry, tmp_path, ("two-renders",), **alone) > 0
    # What is drawn already is not drawn again.
    assert Counted.count - before == 3 * (1 + 2)


def test_surfels_are_drawn_and_saved_as_discs(registry, tmp_path):
    made = single_pass(registry, head="surfels")(views((32, 48)))
    scene = made.gaussians
    smaller = scene.scales[..., :2].amin(-1)
    assert torch.allclose(scene.scales[..., 2], 1e-3 * smaller)
    save_ply(tmp_path / "scene.ply", scene)
    again = load_ply(tmp_path / "scene.ply")
    assert torch.allclose(again.scales, scene.scales, rtol=1e-5)
    cameras = Cameras(made.cameras.c2w, views().intrinsics, (32, 48))
    drawn = edit3r.build("rasterizer", "numba").render(scene, cameras)
    assert float(drawn.alphas.mean()) > 0.5
    read = edit3r.build("rasterizer", "torch").render(again, cameras)
    assert torch.allclose(drawn.images, read.images, atol=1e-3)


@pytest.mark.parametrize("name", ["numba", "torch"])
def test_a_disc_is_seen_face_on_and_hardly_edge_on(name):
    def area(quat):
        disc = edit3r.Gaussians(
            means=torch.tensor([[[0.0, 0.0, 3.0]]]),
            scales=torch.tensor([[[0.3, 0.3]]]),
            quats=torch.tensor([[quat]]),
            opacities=torch.ones(1, 1),
            harmonics=torch.zeros(1, 1, 1, 3),
        )
        camera = cameras_around(1, (64, 64))
        return float(edit3r.build("rasterizer", name).render(disc, camera).alphas.sum())

    half = 0.5**0.5
    # The normal is the third axis; a quarter turn about x lays it across the view.
    assert area([half, half, 0.0, 0.0]) < 0.2 * area([1.0, 0.0, 0.0, 0.0])


def test_a_backbone_s_poses_are_the_scene_s(registry):
    photos = views()
    made = single_pass(registry, fit="pad")(photos)
    assert made.cameras.c2w[0, 1, :3, 3].tolist() == [0.25, 0, 0]
    assert made.cameras.image_size == photos.image_size
    assert torch.allclose(made.cameras.intrinsics, photos.intrinsics, atol=1e-6)
    with collecting(Report()) as report:
        found = edit3r.run(
            views((64, 64)),
            "make everything grey",
            recon=single_pass(registry),
            frames=2,
            refine=0,
            outputs=["scene"],
        )
    assert found.cameras.c2w[0, 1, 0, 3] == 0.25
    assert "cameras" not in report.notes


def test_a_run_without_images_ends_before_any_work_with_one_sentence(registry):
    sentence = (
        r"rasterizer 'depths' gives depths and normals, and a run needs images, alphas, "
        r"depths; choose another \(edit3r list-plugins --kind rasterizer\)\."
    )
    for chosen in ("depths", registry.build("rasterizer", "depths")):
        with pytest.raises(SettingsError, match=sentence):
            edit3r.run(
                ["no such photo.png"], "red", rasterizer=chosen, registry=registry
            )


def test_what_a_rasterizer_adds_goes_along(registry):
    scene, cameras = gaussian_cloud(), cameras_around(2)
    depths = registry.build("rasterizer", "depths")
    found = render_each(depths, scene, cameras, "")
    assert found.images is None and set(found.given) == {"depths", "normals"}
    assert found.extra["normals"].shape == (1, 2, 3, *cameras.image_size)
    assert found.to(torch.float64).extra["normals"].dtype == torch.float64
    depths.gives = ("depths",)
    with pytest.raises(PluginError, match="name in its `gives` what it gives: normals"):
        render_each(depths, scene, cameras, "")
    depths.gives = ("alphas", "depths", "normals")
    with pytest.raises(PluginError, match="must return alphas as a tensor, got None"):
        render_each(depths, scene, cameras, "")


def test_the_dpt_head_reads_four_levels_of_many():
    parts = {"backbone": six_levels()}
    head = edit3r.build("head", "dpt-gaussian", parts, **SMALL_DPT)
    assert head.levels == (0, 2, 3, 5) and head.token_widths == (8, 16, 20, 28)
    chosen = {**SMALL_DPT, "levels": (0, 1, 2, 5)}
    head = edit3r.build("head", "dpt-gaussian", parts, **chosen)
    assert head.token_widths == (8, 12, 16, 28)
    with pytest.raises(SettingsError, match=r"levels 0 to 5, got \(0, 1, 2, 6\)"):
        edit3r.build("head", "dpt-gaussian", parts, **chosen | {"levels": (0, 1, 2, 6)})
