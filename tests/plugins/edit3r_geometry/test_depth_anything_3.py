"""Matcher `da3`: its conventions on a network that knows the truth, and the package's own network
with random weights.

The package is outside the pinned set; where it is missing those tests are skipped, and the
truth-telling network still shows that poses, lens, depths and confidence are read as the package
gives them.
"""

import importlib.util
import json

import pytest
import torch
from edit3r_geometry import depth_anything_3
from safetensors.torch import save_file
from torch import nn

import edit3r
from edit3r import Views
from edit3r.contract.errors import InputError, MatchingError, MissingDependencyError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.geometry.cameras import (
    invert_rigid,
    project,
    scale_poses,
    to_pixels,
    unproject,
)
from edit3r.kit.geometry.maps import resize
from edit3r.loading.registry import default_registry, install_hint
from edit3r_testing import CONTRACTS, Contract, claims, contract_for
from edit3r_testing.scenes import photograph

PIP = (
    "pip install --no-deps depth-anything-3==0.1.1 omegaconf "
    "antlr4-python3-runtime==4.9.3 addict einops"
)
installed = pytest.mark.skipif(
    importlib.util.find_spec("depth_anything_3") is None, reason=f"needs {PIP}"
)
UNIT = 3.7  # the network's unit of length is its own
# What is right of a scene is knowledge, which random weights do not have; the truth-telling network
# is asked for it.
LEARNED = "test_an_easy_scene_is_placed_right"


class Truth(nn.Module):
    """Answers as the package does: w2c [1, V, 3, 4] in any frame, K in pixels of its input, depth
    z, confidence > 1.
    """

    def forward(self, images):
        views, size = images.shape[1], tuple(images.shape[-2:])
        scene = photograph(views, (192, 256))
        world = scene.cameras.c2w[:, -1:]  # not the frame of view 0
        c2w = scale_poses(invert_rigid(world) @ scene.cameras.c2w, UNIT)
        depths = UNIT / resize(1 / scene.depths[:, :, None], size)[:, :, 0]
        trust = torch.full_like(depths, 5.0)
        trust[..., : size[1] // 2] = 1.25
        return {
            "extrinsics": invert_rigid(c2w)[:, :, :3],
            "intrinsics": to_pixels(scene.cameras.intrinsics, size),
            "depth": depths,
            "depth_conf": trust,
        }


@pytest.fixture
def truthful(monkeypatch):
    monkeypatch.setattr(depth_anything_3, "_load", lambda *_: Truth())
    settings = depth_anything_3.DepthAnything3Matcher.Settings()
    return depth_anything_3.DepthAnything3Matcher(settings)


@pytest.mark.parametrize(
    "claim", sorted({*claims(CONTRACTS["matcher"])} - {*claims(Contract)})
)
def test_a_network_that_tells_the_truth_keeps_the_contract(truthful, claim):
    class Bound(CONTRACTS["matcher"]):
        _subject = truthful

    getattr(Bound(), claim)()


def test_points_of_one_view_fall_on_the_same_surface_in_the_other(truthful):
    scene = photograph(2, (192, 256))
    geometry = truthful.match(scene.views)
    assert torch.allclose(geometry.intrinsics, scene.cameras.intrinsics, atol=1e-5)
    found, expected = (
        project(
            unproject(depths[0, 0], lenses[0, 0], c2w[0, 0]).flatten(0, 1),
            lenses[0, 1],
            c2w[0, 1],
        )[0]
        for depths, lenses, c2w in (
            (geometry.depths, geometry.intrinsics, geometry.c2w),
            (scene.depths, scene.cameras.intrinsics, scene.cameras.c2w),
        )
    )
    off = ((found - expected) * torch.tensor([256, 192])).norm(dim=-1)
    # the rest lies on depth edges
    assert off.median() < 0.05 and off.quantile(0.95) < 1


def test_confidence_2_counts_as_measured_and_the_unit_is_the_networks(truthful):
    scene = photograph(2, (192, 256))
    geometry = truthful.match(scene.views)
    assert geometry.confidence[..., :100].median() == pytest.approx(0.2)
    assert geometry.confidence[..., 156:].median() == pytest.approx(0.8)
    unit = float((geometry.depths / scene.depths).median())
    assert unit == pytest.approx(UNIT, rel=1e-3)


def test_a_lens_that_contradicts_the_photos_is_said(truthful):
    views = photograph(2, (192, 256)).views
    longer = views.intrinsics * torch.tensor([1.5, 1.5, 1])[:, None] ** torch.eye(3)
    other = Views(views.images, longer)
    with collecting(Report()) as report:
        truthful.match(other)
    assert "another field of view" in report.warnings[0]
    with collecting(Report()) as report:
        truthful.match(Views(other.images, other.intrinsics, assumed=(True, True)))
    assert report.warnings == []
    assert report.notes["matcher.fov"] == pytest.approx(51.6, abs=0.1)


def test_a_photo_of_one_colour_is_refused(truthful):
    grey = Views(torch.full((1, 2, 3, 96, 96), 0.5), torch.eye(3).expand(1, 2, 3, 3))
    with pytest.raises(MatchingError, match="one colour"):
        truthful.match(grey)


def test_where_the_package_is_missing_the_exact_pip_line_is_said():
    offer = default_registry().find("matcher", "da3")
    assert install_hint(offer) == f"install with: {PIP}"


def test_missing_weights_are_told_before_any_work_with_the_line_that_fetches_them(
    monkeypatch, tmp_path
):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    for model in ("da3-small", "da3-base"):
        said = rf"edit3r weights get {model} \(Apache-2.0"
        with pytest.raises(MissingDependencyError, match=said):
            depth_anything_3._load(model, "")
    with pytest.raises(InputError, match=r"matcher\.weights: no file"):
        depth_anything_3._load("da3-small", str(tmp_path / "nothing.safetensors"))


@installed
class TestThePackage:
    """The package's own network, 34 million random parameters, on small images."""

    @pytest.fixture(scope="class")
    def contract(self):
        return contract_for("matcher", "da3", weights="untrained", network_size=112)

    @pytest.mark.parametrize(
        "claim", [claim for claim in claims(CONTRACTS["matcher"]) if claim != LEARNED]
    )
    def test_random_weights_keep_the_contract(self, contract, claim):
        getattr(contract(), claim)()

    def test_points_are_those_that_the_package_itself_makes(self, contract):
        from depth_anything_3.utils.geometry import as_homogeneous, unproject_depth

        views = photograph(3, (112, 112)).views
        matcher = contract().subject
        fov = matcher._network.cam_dec.fc_fov[0]
        nn.init.constant_(fov.bias, 0.8)  # random weights often read no lens
        with torch.no_grad():
            answers = []
            hook = matcher._network.register_forward_hook(
                lambda *call: answers.append(call[-1])
            )
            geometry = matcher.match(views)
            hook.remove()
        answer = answers[0]
        w2c = as_homogeneous(answer["extrinsics"])
        depths, lenses = answer["depth"][..., None], answer["intrinsics"]
        theirs = unproject_depth(depths, lenses, invert_rigid(w2c))[0].flatten(0, 2)
        parts = geometry.depths[0], geometry.intrinsics[0], geometry.c2w[0]
        ours = unproject(*parts).flatten(0, 2)
        in_view_0 = theirs @ w2c[0, 0, :3, :3].T + w2c[0, 0, :3, 3]
        half_a_pixel = 0.02 * in_view_0.norm(dim=-1).median()
        assert (ours - in_view_0).norm(dim=-1).max() < half_a_pixel

    def test_weights_in_the_layout_of_the_hub_are_read_and_others_refused(
        self, contract, tmp_path
    ):
        network = depth_anything_3._untrained("da3-small")
        state = {
            f"model.{name}": value.clone()
            for name, value in network.state_dict().items()
        }
        state["model.cam_dec.fc_t.bias"] += 1
        folder = tmp_path / "da3-small"
        folder.mkdir()
        save_file(state, folder / "model.safetensors")
        loaded = depth_anything_3._load("da3-small", str(folder / "model.safetensors"))
        assert torch.equal(loaded.cam_dec.fc_t.bias, network.cam_dec.fc_t.bias + 1)
        del state["model.cam_dec.fc_t.bias"]
        save_file(state, folder / "model.safetensors")
        said = r"does not hold the weights of da3-small.*fc_t\.bias"
        with pytest.raises(InputError, match=said):
            depth_anything_3._load("da3-small", str(folder / "model.safetensors"))

    def test_its_configuration_loader_can_no_longer_evaluate(self, contract):
        from omegaconf import OmegaConf

        assert not OmegaConf.has_resolver("eval")

    def test_auto_picks_the_best_weights_at_hand_and_says_so(
        self, monkeypatch, tmp_path
    ):
        monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
        monkeypatch.setenv("HF_HOME", str(tmp_path))
        views = photograph(2, (96, 96)).views
        state = depth_anything_3._untrained("da3-small").state_dict()
        for model in ("da3-small", "da3-base"):
            (tmp_path / model).mkdir()
            (tmp_path / model / "config.json").write_text("{}")
        saved = {f"model.{name}": value.clone() for name, value in state.items()}
        save_file(saved, tmp_path / "da3-small" / "model.safetensors")
        with collecting(Report()) as report:
            matcher = edit3r.build("matcher", "auto")
            matcher.match(views)
        assert matcher.settings.pick == "da3-small"
        assert report.notes["matcher.picked"] == "da3 (da3-small)"
        (tmp_path / "da3-base" / "model.safetensors").write_bytes(b"")
        settings = default_registry().settings_class(
            default_registry().find("matcher", "auto")
        )
        assert settings.model_validate({}).pick == "da3-base"


@pytest.mark.slow
def test_auto_without_weights_is_its_matcher_and_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    events = []
    with collecting(Report(on_event=lambda *event: events.append(event[:2]))) as report:
        classical = {"name": "classical", "working_size": 96}
        matcher = edit3r.build("matcher", "auto", matcher=classical)
        geometry = matcher.match(photograph(2, (192, 256)).views)
    assert ("say", "matcher: classical") in events
    assert report.notes["matcher.picked"] == "classical"
    assert matcher.matcher.settings.working_size == 96
    assert bool(geometry.registered.all())
    assert json.loads(matcher.settings.model_dump_json())["pick"] == "part"
