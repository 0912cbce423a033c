"""One edit by one method: edit, reconstruct, render at the scene's frames, measure, leave pictures.

Killing it at any moment leaves no result, only pictures that the next attempt overwrites.
"""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import pipeline
from edit3r.config import make_settings
from edit3r.errors import InputError, MatchingError, PluginError, PromptError, RunError
from edit3r.geometry.paths import between_and_around
from edit3r.interfaces import Editor
from edit3r.io.images import save_image
from edit3r.registry import Registry
from edit3r.reporting import Report, collecting
from edit3r.results import render_each
from edit3r.types import Cameras, Rendering
from edit3r_measure.bench.loading import LoadedItem, load_item
from edit3r_measure.bench.manifest import Manifest
from edit3r_measure.bench.measure import Instruments, Shown, measure, measure_failure
from edit3r_measure.bench.method import InstrumentSettings, Method
from edit3r_measure.bench.oracle import ORACLE, OracleEditor, OracleSettings
from edit3r_measure.bench.results import ItemResult
from edit3r_measure.evaluation.stopwatch import timing_of

__all__ = ["Bench", "build_instruments"]

FAILURES = (MatchingError, PromptError, RunError, PluginError)
"""Errors that are a result of the method; any other ends the benchmark, since the wish itself was wrong."""


@dataclass
class Bench:
    """A method, built once, and the manifest it works through. `cold` until its first item is done."""

    manifest: Manifest
    root: Path  # the manifest's folder
    method: Method
    out: Path
    registry: Registry
    instruments: Instruments
    verify: bool = True
    cold: bool = True
    _built: dict[str, Any] = field(default_factory=dict)

    def __call__(self, item_id: str) -> ItemResult:
        """Do one item; a failure of the method is a result, with its sentence."""
        record = self.manifest.item(item_id)
        item = load_item(self.manifest, record, self.root, self.registry, self.verify)
        report = Report()
        try:
            with collecting(report), torch.no_grad():
                shown, facts = self._show(item, report)
        except FAILURES as error:
            self.cold = False
            return ItemResult(
                record.id, record.scene, record.type, measure_failure(item, self.has_truth(item)), str(error)
            )
        timing, self.cold = timing_of(report.stages, self.cold), False
        metrics = measure(item, shown, self.instruments)
        save_pictures(self.out / "pictures" / record.id, item, shown)
        return ItemResult(record.id, record.scene, record.type, metrics, "", asdict(timing), facts)

    def has_truth(self, item: LoadedItem) -> bool:
        """Whether `item`'s truth is what the method is judged by."""
        wished = self.method.editor.name == ORACLE if self.method.truth is None else self.method.truth
        return wished and item.truth is not None

    def _show(self, item: LoadedItem, report: Report) -> tuple[Shown, dict[str, Any]]:
        chosen = self.method
        views = item.given
        if chosen.poses and item.cameras is not None:
            views = replace(views, c2w=item.cameras.c2w[:, : item.inputs])
        result = pipeline.run(
            views,
            item.record.prompt,
            editor=self._editor(item),
            recon=self._component("reconstructor", chosen.reconstructor),
            masks=item.input_masks,
            edit_views=chosen.edit_views,
            seed=item.record.seed,
            registry=self.registry,
            report=report,
        )
        cameras = evaluation_cameras(item, result.cameras)
        rasterizer = self._component("rasterizer", chosen.rasterizer)
        with report.stage("render"):
            rendering = render_each(rasterizer, result.gaussians, cameras, "render")
        facts = {"gaussians": result.gaussians.count, "warnings": report.warnings}
        edited = result.edited.images[0]
        return _shown(rendering, edited, cameras, self.has_truth(item)), facts

    def _editor(self, item: LoadedItem) -> Editor:
        if self.method.editor.name != ORACLE:
            return self._component("editor", self.method.editor)
        if item.truth is None:
            raise InputError(f"{item.record.id}: the editor 'oracle' needs scenes whose edited truth is known.")
        settings = make_settings(OracleSettings, self.method.editor.settings, where="editor")
        return OracleEditor(item.truth[: item.inputs], settings)

    def _component(self, kind: str, choice: Any) -> Any:
        """Built once; a reconstructor that edits is built by the pipeline, with each item's editor."""
        if "editor" in self.registry.find(kind, choice.name).component.parts:
            return choice
        if kind not in self._built:
            self._built[kind] = self.registry.build(kind, choice.name, **choice.settings)
        return self._built[kind]


def _shown(rendering: Rendering, edited: Tensor, cameras: Cameras, has_truth: bool) -> Shown:
    images = rendering.images[0].clamp(0, 1)
    return Shown(images, edited, rendering.depths[0, :, 0], cameras, has_truth)


def evaluation_cameras(item: LoadedItem, predicted: Cameras) -> Cameras:
    """Where the result is looked at: the inputs' predicted cameras, and the held-back frames.

    Those stand at their true places relative to the reference, in the unit of length that makes the inputs' mean
    distance from it the true one. Without known poses there are none, and as many places between the inputs are
    looked at instead.
    """
    more = len(item.record.held_back)
    if item.cameras is None:
        path = between_and_around(predicted, 2 * (more + 1)).select(range(1, more + 1))
        return _joined(predicted, path.c2w, path.intrinsics)
    true = item.cameras.c2w.to(predicted.c2w)
    lengths = [c2w[:, 1 : item.inputs, :3, 3].norm(dim=-1).mean() for c2w in (predicted.c2w, true)]
    held_back = true[:, item.inputs :].clone()
    held_back[..., :3, 3] *= lengths[0] / lengths[1].clamp(min=1e-12)
    return _joined(predicted, predicted.c2w[:, :1] @ held_back, item.cameras.intrinsics[:, item.inputs :])


def _joined(cameras: Cameras, c2w: Float[Tensor, "1 more 4 4"], intrinsics: Float[Tensor, "1 more 3 3"]) -> Cameras:
    like = cameras.c2w
    return Cameras(
        torch.cat((like, c2w.to(like)), 1),
        torch.cat((cameras.intrinsics, intrinsics.to(like)), 1),
        cameras.image_size,
    )


def save_pictures(folder: Path, item: LoadedItem, shown: Shown) -> None:
    """One strip of frames each for photos, 2D edits, what the method shows, and the truth."""
    folder.mkdir(parents=True, exist_ok=True)
    strips = {"photos": item.photos.images[0], "edited": shown.edited, "shown": shown.images}
    if shown.has_truth:
        strips["truth"] = item.truth
    for name, images in strips.items():
        save_image(torch.cat(list(images), -1), folder / f"{name}.png")


def build_instruments(settings: InstrumentSettings, registry: Registry) -> Instruments:
    """Load the networks that metrics need. Raises MissingDependencyError for those whose package is not installed."""
    from edit3r_measure.evaluation.clip import ClipSimilarity
    from edit3r_measure.evaluation.features import EffnetFeatures, InceptionFeatures

    networks = []
    if settings.inception:
        networks.append(InceptionFeatures(settings.inception))
    if settings.effnet:
        networks.append(EffnetFeatures())
    clip = ClipSimilarity(settings.clip) if settings.clip else None
    lpips = registry.build("loss", "lpips") if settings.lpips else None
    return Instruments(tuple(networks), clip, lpips)
