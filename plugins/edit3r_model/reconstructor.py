"""Reconstructors `edit3r` and `noposplat`: parts, weights, and the form that the head asks for."""

from collections.abc import Mapping
from typing import Any

import torch
from pydantic import model_validator

from edit3r.contract.errors import MissingDependencyError, SettingsError
from edit3r.contract.interfaces import Backbone, GaussianHead, Geometry, Reconstructor
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Reconstruction, Views
from edit3r.kit.checks import require_geometry
from edit3r.kit.weights.load import pick_device
from edit3r_model.checkpoints import load_weights, with_parts_of
from edit3r_model.engine import EnginePlan, make_plan
from edit3r_model.matched_form import MatchedForm, MatchedSettings
from edit3r_model.network import UNTRAINED, GaussianNetwork, load_network
from edit3r_model.official_checkpoints import EMPTY
from edit3r_model.single_pass import SinglePass, SinglePassSettings


class NetworkSettings(SinglePassSettings):
    """Parts and weights. Weights that name their parts fill in those that the user left open."""

    backbone: PartChoice
    head: PartChoice
    weights: str | None
    seed: int = 0
    """of weights that are drawn rather than loaded"""

    @model_validator(mode="before")
    @classmethod
    def _with_the_parts_of_its_weights(cls, values: Any) -> Any:
        if not isinstance(values, Mapping):
            return values
        weights = values.get("weights", cls.model_fields["weights"].default)
        if not isinstance(weights, str) or weights in UNTRAINED:
            return values
        return with_parts_of(load_weights(weights), values)


class NetworkReconstructor(Reconstructor):
    """A backbone and a head with their weights, in the form that the head asks for."""

    settings: NetworkSettings

    def __init__(
        self, settings: NetworkSettings, backbone: Backbone, head: GaussianHead
    ) -> None:
        self.settings = settings
        self.uses_geometry = head.uses_geometry
        self.fuses_by_itself = not self.uses_geometry
        _check_parts(settings, backbone, head)
        assert settings.weights is not None  # checked
        network = GaussianNetwork(backbone, head)
        plan = _plan(settings) if self.fuses_by_itself else EnginePlan()
        self._network = load_network(network, settings.weights, plan, settings.seed)
        self.form: SinglePass | MatchedForm
        if isinstance(settings, MatchedSettings) and self.uses_geometry:
            self.form = MatchedForm(settings, network)
        else:
            self.form = SinglePass(settings, network)

    @property
    def network(self) -> GaussianNetwork:
        """The trainable part: backbone and head together."""
        return self._network

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: Geometry | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        """Reconstruct; a single pass uses the views alone."""
        if isinstance(self.form, SinglePass):
            return self.form(views)
        geometry = require_geometry(self, geometry)
        return self.form(views, views if source is None else source, geometry, grid)

    def weights_metadata(self) -> dict[str, str]:
        """Which parts the network's weights are for, and the size they were trained at."""
        about = {}
        parts = {"backbone": self.network.backbone, "head": self.network.head}
        for kind, part in parts.items():
            # The correction of depth counts in training only.
            kept = part.settings.model_dump(exclude={"depth_repair"})
            choice = PartChoice(name=part.offer.component.name, settings=kept)
            about[kind] = choice.model_dump_json()
        if isinstance(self.form, SinglePass):
            about["resolution"] = str(self.form.resolution)
        return about


class Edit3rReconstructor(NetworkReconstructor):
    """A backbone and a head, in the form that the head asks for.

    A head that takes geometry: poses and depths are the run's, the network draws disagreeing edits
    to the reference's. View 0 is the reference: its edit is kept as it is. Where another view's
    edit is the same function of colour, that view keeps its own edited colours exactly, as it does
    without any edit.

    Any other head: the paper's form, a single pass from the edited photos alone.
    """

    class Settings(NetworkSettings, MatchedSettings):
        backbone: PartChoice = PartChoice(name="matched-unet")
        """images and geometry to features"""
        head: PartChoice = PartChoice(name="edit-fusion")
        """features to Gaussians"""
        weights: str = "shipped"
        """'shipped', 'untrained', 'official' (the authors' own), a file, or the folder best of
        `edit3r train`; a file that names its parts brings them along
        """

    settings: Settings


class NoPoSplatReconstructor(NetworkReconstructor):
    """The same network in a single pass: baseline, and reference of the training."""

    class Settings(NetworkSettings):
        backbone: PartChoice = PartChoice(name="asymmetric-vit", settings=EMPTY)
        """views to features"""
        head: PartChoice = PartChoice(name="dpt-gaussian", settings=EMPTY)
        """features to Gaussians"""
        weights: str | None = None
        """'official' (the authors' own), NoPoSplat .ckpt, MASt3R .pth (initialisation),
        .safetensors, the folder best of `edit3r train`, or 'random' for an untrained network (tests
        and speed only)
        """

    settings: Settings


def _plan(settings: SinglePassSettings) -> EnginePlan:
    """Where and in which precision a single pass computes."""
    best = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    device = pick_device(settings.device, best, "reconstructor.device")
    return make_plan(settings.precision, settings.head_precision, device)


def _check_parts(
    settings: NetworkSettings, backbone: Backbone, head: GaussianHead
) -> None:
    """Raise for parts and settings that do not go together, and where there are no weights."""
    if settings.weights is None:
        raise MissingDependencyError(
            "reconstructor noposplat ships no weights; give some with --set "
            "reconstructor.weights=FILE (a NoPoSplat .ckpt, or a folder of edit3r train), or use "
            "the reconstructor edit3r."
        )
    if not head.uses_geometry:
        if backbone.uses_geometry:
            raise SettingsError(
                "reconstructor.backbone: this backbone needs matched geometry, but the head takes "
                "none; choose another backbone, such as asymmetric-vit."
            )
        return
    if not isinstance(settings, MatchedSettings):
        raise SettingsError(
            "reconstructor.head: this head needs matched geometry, but this reconstructor reads "
            "none; use the reconstructor edit3r."
        )
    given = settings.model_fields_set & SinglePassSettings.model_fields.keys()
    if given:
        raise SettingsError(
            f"reconstructor.{min(given)}: applies only to a head that takes no geometry, as with "
            "weights=official."
        )
