"""The reconstructor's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from edit3r.contract.interfaces import FindsGeometry, Reconstructor
from edit3r.contract.types import Cameras, Reconstruction
from edit3r.kit.geometry.cameras import pixels_to_gaussians
from edit3r_testing import ContractViolation, ReconstructorContract
from edit3r_testing.network import TinyBackbone
from edit3r_testing.scenes import true_geometry


class Flat(Reconstructor):
    """Every pixel at one depth, a learned gain on the colours; its answer is passed through
    `spoil`.
    """

    def __init__(self, spoil=None, before=None, least=2):
        self.gain = nn.Linear(1, 1, bias=False)
        nn.init.constant_(self.gain.weight, 0.9)
        self.spoil, self.before, self.min_views, self.calls = spoil, before, least, 0

    @property
    def network(self):
        return self.gain

    def __call__(self, views, source=None, geometry=None, grid=None):
        self.calls += 1
        if self.before:
            self.before(views, source)
        ones = torch.ones_like(views.images[:, :, 0])
        c2w = torch.eye(4).expand(*ones.shape[:2], 4, 4).clone()
        cameras = Cameras(c2w, views.intrinsics, views.image_size)
        colours = self.gain.weight * views.images
        sizes = 0.01 * ones, 0.5 * ones
        made = pixels_to_gaussians(colours, 3 * ones, cameras, *sizes)
        answer = Reconstruction(made, cameras)
        return self.spoil(self, views, answer) if self.spoil else answer


class Forgetful(Flat):
    """What it depends on is not in its network."""

    made = 0

    def __init__(self):
        super().__init__(
            lambda me, views, answer: changed(
                answer, means=answer.gaussians.means + me.shift
            )
        )
        type(self).made += 1
        self.shift = type(self).made


def changed(answer, **fields):
    return replace(answer, gaussians=replace(answer.gaussians, **fields))


def placed(answer, **fields):
    return replace(answer, cameras=replace(answer.cameras, **fields))


def beside(c2w):
    """Cameras that all stand elsewhere, the first as well."""
    moved = c2w.clone()
    moved[..., :3, 3] += 1
    return moved


def scaled_by_the_batch(me, views, answer):
    return changed(answer, scales=answer.gaussians.scales * (1 + views.images.mean()))


def counted(me, views, answer):
    return changed(answer, opacities=answer.gaussians.opacities / me.calls)


def brighten(views, source):
    views.images.add_(0.1)


def refuse_source(views, source):
    if source is not None:
        raise TypeError("unexpected argument")


def two_views_only(views, source):
    if views.count != 2:
        raise RuntimeError("size mismatch")


def divide_by_contrast(views, source):
    if views.images.std() == 0:
        raise ZeroDivisionError("division by zero")


VALID = "test_gaussians_are_valid_and_finite"
CAMERAS = "test_predicted_cameras_are_poses_of_the_views"
CASES = {
    "views from 1": (
        {"spoil": lambda m, v, a: changed(a, view_index=a.gaussians.view_index + 1)},
        VALID,
        "return view_index from -1 to 1, got 1 to 2",
    ),
    "no source": (
        {"before": refuse_source},
        "test_source_photos_are_accepted",
        "raised TypeError: unexpected argument",
    ),
    "pixel size changed": (
        {"spoil": lambda m, v, a: placed(a, image_size=(256, 256))},
        CAMERAS,
        "keep the photos' size",
    ),
    "world poses": (
        {"spoil": lambda m, v, a: placed(a, c2w=beside(a.cameras.c2w))},
        CAMERAS,
        "in the frame of view 0",
    ),
    "fewer views than declared": (
        {"before": two_views_only},
        "test_declared_limits_are_true",
        "raised RuntimeError: size mismatch",
    ),
    "batch statistics": (
        {"spoil": scaled_by_the_batch},
        "test_batch_items_are_independent",
        "LayerNorm",
    ),
    "a state": (
        {"spoil": counted},
        "test_same_photos_give_the_same_result",
        "seed what is random",
    ),
    "writes into the photos": (
        {"before": brighten},
        "test_leaves_its_inputs_alone",
        "clone it first",
    ),
    "no gradients": (
        {"spoil": lambda m, v, a: changed(a, harmonics=a.gaussians.harmonics.detach())},
        "test_a_step_of_training_reaches_the_network",
        "no gradient arrives",
    ),
    "falls over grey photos": (
        {"before": divide_by_contrast},
        "test_photos_without_texture_end_in_a_result_or_a_sentence",
        "raise edit3r.contract.errors.MatchingError",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_reconstructor_broken_by(case, complaint):
    changes, claim, advice = CASES[case]
    assert advice in complaint(
        ReconstructorContract, lambda: Flat(**changes), claim, image_size=(24, 32)
    )


def test_a_network_that_is_not_all_of_it_is_found(complaint):
    said = complaint(
        ReconstructorContract,
        Forgetful,
        "test_checkpoint_round_trip",
        image_size=(24, 32),
    )
    assert "register everything the result depends on" in said


class Detached(Flat):
    """Its backbone is in the network, but no gradient gets that far."""

    def __init__(self):
        super().__init__(
            lambda me, views, answer: changed(
                answer, opacities=answer.gaussians.opacities * me.seen(views)
            )
        )
        self.gain.backbone = TinyBackbone()

    def seen(self, views):
        images = views.images[..., :16, :32]
        return (
            self.gain.backbone(images, views.intrinsics)
            .levels[0]
            .mean()
            .detach()
            .sigmoid()
        )


def test_a_backbone_that_learns_nothing_is_found(complaint):
    claim = "test_a_step_of_training_reaches_the_network"
    said = complaint(ReconstructorContract, Detached, claim, image_size=(24, 32))
    assert "no gradient arrives in the backbone 'backbone'" in said


WEIGHTS = "test_trained_weights_load_by_the_setting_weights"
PLUGIN = """
from pydantic import Field
from torch import nn

from edit3r import Component, Settings, hookimpl
from edit3r.kit.geometry.cameras import pixels_to_gaussians
from edit3r.contract.interfaces import FindsGeometry, Reconstructor
from edit3r.kit.weights.files import load_weights
from edit3r.contract.types import Cameras, Reconstruction

EDIT3R_API = 1


class Gain(Reconstructor):
    class Settings(Settings):
        {setting}

    def __init__(self, settings):
        self.settings, self._network = settings, nn.Conv2d(3, 3, 1)
        {load}

    @property
    def network(self):
        return self._network

    def __call__(self, views, source=None, geometry=None, grid=None):
        images = self._network(views.images.flatten(0, 1)).sigmoid()
        images = images.unflatten(0, views.images.shape[:2])
        depths = images.new_full(images[:, :, 0].shape, 3.0)
        poses = images.new_zeros(*images.shape[:2], 4, 4) + images.new_ones(4).diag()
        cameras = Cameras(poses, views.intrinsics, views.image_size)
        sizes = (depths / 32, depths / 4)
        gaussians = pixels_to_gaussians(images, depths, cameras, *sizes)
        return Reconstruction(gaussians, cameras)


@hookimpl
def register_reconstructors():
    return [Component("{name}", "{module}:Gain", "a gain", min_views=2)]
"""


def _own(folder, name, setting, load):
    """The attributes of a contract that tries the reconstructor of a plugin file of one's own."""
    file = folder / f"{name}_plugin.py"
    file.write_text(
        PLUGIN.format(name=name, module=file.stem, setting=setting, load=load)
    )
    return {"component": name, "plugin_files": (file,), "image_size": (24, 32)}


SETTING = "weights: str | None = Field(None, description='folder of a training')"


def test_weights_that_load_keep_the_contract(tmp_path):
    load = "None if settings.weights is None else load_weights(self._network, settings.weights)"
    attributes = _own(tmp_path, "loading", SETTING, load)
    getattr(type("Bound", (ReconstructorContract,), attributes)(), WEIGHTS)()


@pytest.mark.parametrize(
    ("name", "setting", "advice"),
    [
        ("without", "pass", "give its class a setting `weights`"),
        ("ignoring", SETTING, "loaded weights give another result"),
    ],
)
def test_trained_weights_that_cannot_be_used_are_found(tmp_path, name, setting, advice):
    attributes = _own(tmp_path, name, setting, "pass")
    with pytest.raises(ContractViolation, match=advice):
        getattr(type("Bound", (ReconstructorContract,), attributes)(), WEIGHTS)()


class FindsDepthsAlone(Flat, FindsGeometry):
    def find_geometry(self, views):
        return replace(true_geometry(views), c2w=torch.zeros(1, views.count, 4, 4))


def test_geometry_of_its_own_that_is_wrong_is_found(complaint):
    assert "a rotation" in complaint(
        ReconstructorContract,
        FindsDepthsAlone,
        "test_geometry_of_its_own_is_valid",
        image_size=(24, 32),
    )


def test_every_claim_about_reconstructors_can_fail():
    own = {name for name in vars(ReconstructorContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()} | {
        "test_geometry_of_its_own_is_valid",
        "test_checkpoint_round_trip",
        WEIGHTS,
    }
