"""Geometry belongs to the run: what finds it by itself, was built by hand or needs none is a full
part.
"""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from edit3r_model.edit_fusion_head import EditFusionHead
from edit3r_model.matched_unet import MatchedUNet
from edit3r_model.reconstructor import Edit3rReconstructor

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import SettingsError
from edit3r.contract.interfaces import FindsGeometry, Matcher, Reconstructor
from edit3r.contract.reporting import Report
from edit3r.contract.types import Cameras, Reconstruction
from edit3r.kit.geometry.cameras import (
    field_of_view,
    pixel_scales,
    pixels_to_gaussians,
)
from edit3r.kit.photos.camera_files import read_scene_cameras
from edit3r.kit.photos.images import save_image
from edit3r.loading.load import load_plugins
from edit3r.loading.registry import Registry, default_registry
from edit3r.running.geometry import default_matcher
from edit3r_testing import photograph

pytestmark = pytest.mark.slow
HERE = Path(__file__).parent
SCENE = photograph(3, (96, 128))
PLAIN = {"gaussians": "all", "refine": 0, "refiners": (), "report": Report()}
CLICK = edit3r.Selection(positive=((0, 0.68, 0.4),))


def darker(scene):
    """The photos, the last one taken in less light."""
    images = scene.views.images.clone()
    images[:, -1] = 0.6 * images[:, -1] + 0.02
    return replace(scene.views, images=images, names=("a", "b", "c"))


PHOTOS = darker(SCENE)


class FindsByItself(Reconstructor, FindsGeometry):
    """Finds poses and depths as VGGT does, and lifts its pixels to them; built by hand."""

    uses_geometry = True  # what it found is handed back to it

    def __init__(self):
        self.asked, self.given = [], []

    def find_geometry(self, views):
        self.asked.append(views)
        return default_matcher(default_registry()).match(views)

    def __call__(self, views, source=None, geometry=None, grid=None):
        self.given.append(source)
        lens, depths = geometry.calibrated(views).intrinsics, geometry.depths
        cameras = Cameras(geometry.c2w, lens, views.image_size)
        scales = pixel_scales(depths, lens, 0.6)
        opacities = torch.full_like(depths, 0.9)
        made = pixels_to_gaussians(views.images, depths, cameras, scales, opacities)
        return Reconstruction(made, cameras, geometry.registered, geometry.measured)


@pytest.fixture(scope="module")
def by_name():
    return edit3r.run(PHOTOS, "paint it red", masks=CLICK, recon="edit3r", **PLAIN)


def test_one_that_finds_geometry_by_itself_is_a_full_part(by_name):
    recon = FindsByItself()
    made = edit3r.run(PHOTOS, "paint it red", masks=CLICK, recon=recon, **PLAIN)
    assert torch.equal(made.masks, by_name.masks) and made.masks[0, 2].any()
    assert torch.equal(made.edited.images, by_name.edited.images)
    assert len(recon.asked) == 1  # once, for selecting, exposure and verdict alike
    dark = (PHOTOS.images - SCENE.views.images).abs().mean()
    for source in recon.given:  # in one exposure
        assert (source.images - SCENE.views.images).abs().mean() < 0.2 * dark
    assert None not in made.verdict.guessed_between
    assert made.verdict.guessed_between == by_name.verdict.guessed_between
    with pytest.raises(SettingsError, match="finds geometry by itself"):
        edit3r.run(PHOTOS, "paint it red", recon=recon, matcher="classical", **PLAIN)


def test_ours_built_by_hand_makes_the_same_bytes(by_name, tmp_path):
    settings = Edit3rReconstructor.Settings()
    backbone = MatchedUNet(MatchedUNet.Settings(**settings.backbone.settings))
    head = EditFusionHead(
        EditFusionHead.Settings(**settings.head.settings), backbone=backbone
    )
    recon = Edit3rReconstructor(settings, backbone, head)
    by_hand = edit3r.run(PHOTOS, "paint it red", masks=CLICK, recon=recon, **PLAIN)
    first, second = (
        (one.save(tmp_path / name) / "scene.ply").read_bytes()
        for name, one in (("hand", by_hand), ("name", by_name))
    )
    assert first == second


class Counting(Matcher):
    count = 0

    def match(self, views):
        Counting.count += 1
        return default_matcher(default_registry()).match(views)


VIT = {"name": "asymmetric-vit", "width": 32, "depth": 1, "heads": 2}
VIT |= {"decoder_width": 24, "decoder_depth": 4, "decoder_heads": 2}
DPT = {"name": "dpt-gaussian", "feature_width": 8, "point_width": 8}
DPT |= {"layer_widths": (4, 4, 8, 8)}
HEADS = HERE / "plugins/edit3r_model/plain_head.py"
SINGLE_PASSES = {
    "noposplat": ("noposplat", "random", DPT),
    "edit3r with dpt": ("edit3r", "untrained", DPT),
    "edit3r with a stranger's head": ("edit3r", "untrained", "wall"),
}


def of_a_single_pass(name, folder, out, **more):
    """What reaches the network of a run on photo files, and its `run.json`."""
    recon, weights, head = SINGLE_PASSES[name]
    settings = {"device": "cpu", "weights": weights, "backbone": VIT, "head": head}
    registry = Registry(load_plugins((HEADS,)))
    built = registry.build("reconstructor", recon, **settings)
    reached = []
    take = lambda _, given: reached.append(given[:2])  # noqa: E731
    built.network.backbone.register_forward_pre_hook(take)
    asked = {"recon": built, "matcher": Counting(), "outputs": ["scene"], **PLAIN}
    asked["report"] = Report()
    made = edit3r.run(folder, editor="none", **asked, **more)
    told = json.loads((made.save(out) / "run.json").read_text())
    ((images, lens),) = reached
    return images, lens, told


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "photos").mkdir()
    for name, image in zip("abc", PHOTOS.images[0]):
        save_image(image, tmp_path / "photos" / f"{name}.png")
    return tmp_path / "photos"


@pytest.mark.parametrize("more", [{}, {"fov": 40}], ids=["no lens", "--fov"])
def test_a_single_pass_asks_no_matcher_and_gets_the_photos_as_they_are(
    folder, tmp_path, more
):
    before = Counting.count
    runs = [
        of_a_single_pass(name, folder, tmp_path / str(index), **more)
        for index, name in enumerate(SINGLE_PASSES)
    ]
    assert Counting.count == before
    for images, lens, told in runs:
        assert torch.equal(images, runs[0][0]) and torch.equal(lens, runs[0][1])
        (said,) = told["notes"]["lens.source"]
        assert said.startswith("--fov 40" if more else "default"), said
        assert "geometry" not in [stage["name"] for stage in told["stages"]]


def test_a_stranger_s_matcher_is_the_run_s(folder, tmp_path):
    plugin, out = str(HERE / "strangers/truth.py"), tmp_path / "out"
    command = ["run", str(folder), "--editor", "none", "--recon", "classical"]
    command += ["--matcher", "truth", "--plugin", plugin, "--fov", "51.566"]
    command += ["--outputs", "scene", "--gaussians", "all", "--out", str(out)]
    assert main(command) == 0
    told = json.loads((out / "run.json").read_text())
    asked = {one["kind"]: one["name"] for one in told["plugins"]}
    assert asked["matcher"] == "truth"
    cameras, _ = read_scene_cameras(out / "cameras.json")
    torch.testing.assert_close(
        cameras.c2w[..., :3, :3], SCENE.cameras.c2w[..., :3, :3], atol=1e-4, rtol=0
    )
    assert field_of_view(SCENE.views) == pytest.approx(51.566, abs=0.01)
