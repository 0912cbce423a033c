"""Take one method through one item of a benchmark: edit, reconstruct, render.

What is killed at any moment leaves no result, only images that the next attempt overwrites.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

import edit3r
from edit3r import Registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Editor
from edit3r.contract.reporting import Report
from edit3r.contract.settings import PartChoice, make_settings
from edit3r.contract.types import RENDERED, Cameras, EditRequest
from edit3r.kit import asking
from edit3r.kit.checks import require_gives
from edit3r.kit.contact_sheet import draw_sheet
from edit3r.kit.geometry.cameras import scale_poses
from edit3r.kit.geometry.maps import composite
from edit3r.kit.geometry.paths import between_and_around
from edit3r.kit.rendering import render_each
from edit3r.running import instructions_for
from edit3r_bench.manifest import Images, LoadedItem, Maps
from edit3r_bench.method import Method
from edit3r_bench.oracle import ORACLE, OracleEditor, OracleSettings


@dataclass(frozen=True)
class MethodOutput:
    """What a method shows at the item's frames, inputs first."""

    images: Images  # renderings in [0, 1]
    edited: Images  # the 2D edits of the inputs
    # of the renderings, in the unit of `cameras`
    depths: Maps
    cameras: Cameras  # batch 1, as rendered
    has_truth: bool  # whether the item's truth is what the editor was to show
    gaussians: int = 0
    verdict: str = ""  # the run's label of the scene


@dataclass(frozen=True)
class ItemRunner:
    """Does items by one method; what it builds is kept for the next item."""

    method: Method
    registry: Registry
    _built: dict[str, Any] = field(default_factory=dict)

    def __call__(self, item: LoadedItem, report: Report) -> MethodOutput:
        """Return what the method makes of the item, and tell `report` its stages."""
        if self.method.edit_renders:
            output = self._reconstruct(item, "none", report)
            with report.stage("edit (the renderings)"):
                images = self._edit_each(item, output.images)
            return replace(output, images=images, edited=images[: item.inputs])
        return self._reconstruct(item, self._editor(item, item.truth), report)

    def _reconstruct(
        self, item: LoadedItem, editor: Editor | PartChoice | str, report: Report
    ) -> MethodOutput:
        """Edit and reconstruct the inputs, and render the scene at all frames."""
        method, inputs = self.method, range(item.inputs)
        views = item.photos.select(inputs)
        if method.poses and item.cameras is not None:
            views = replace(views, c2w=item.cameras.c2w[:, inputs])
        rasterizer = self._component("rasterizer", method.rasterizer)
        require_gives(rasterizer, method.rasterizer.name, *RENDERED, who="bench")
        result = edit3r.run(
            views,
            item.record.prompt,
            editor=editor,
            recon=self._component("reconstructor", method.reconstructor),
            masks=None if item.masks is None else item.masks[None, inputs],
            edit_views=method.edit_views,
            seed=item.record.seed,
            registry=self.registry,
            report=report,
            **method.run,
        )
        cameras = evaluation_cameras(item, result.cameras)
        gaussians = result.gaussians
        if method.gaussians_of == "first":
            gaussians = gaussians.from_view(0)
        with report.stage("render"):
            rendering = render_each(rasterizer, gaussians, cameras, "render")
        return MethodOutput(
            images=rendering.images[0].clamp(0, 1),
            edited=result.edited.images[0],
            depths=rendering.depths[0, :, 0],
            cameras=cameras,
            has_truth=self.has_truth(item),
            gaussians=gaussians.count,
            verdict=result.verdict.label,
        )

    def has_truth(self, item: LoadedItem) -> bool:
        """Whether the item's truth is what the method is judged by."""
        return self.method.judged_by_truth and item.truth is not None

    def _edit_each(self, item: LoadedItem, images: Images) -> Images:
        """Edit renderings instead of photos, within the mask. The oracle adds the true change."""
        truth = None
        if item.truth is not None:
            truth = (images + item.truth - item.photos.images[0]).clamp(0, 1)
        masks = None if item.masks is None else item.masks[None].nan_to_num(1.0)
        views = replace(item.photos, images=images[None])
        editor = self._editor(item, truth)
        assert isinstance(editor, Editor)  # what is built later edits photos alone
        instructions = instructions_for(editor, item.record.prompt)
        request = EditRequest(item.record.prompt, item.record.seed, masks, instructions)
        edited = asking.edit(editor, views, request).images
        if masks is not None:
            edited = composite(images[None], edited, masks)
        return edited[0]

    def _editor(self, item: LoadedItem, truth: Images | None) -> Editor | PartChoice:
        editor = self.method.editor
        if editor.name != ORACLE:
            return self._component("editor", editor)
        if truth is None:
            raise InputError(
                f"{item.record.id}: the editor 'oracle' needs scenes whose edited truth is known."
            )
        settings = make_settings(OracleSettings, editor.settings, where="editor")
        return OracleEditor(truth, settings)

    def _component(self, kind: str, choice: PartChoice) -> Any:
        """Build a component once; the run builds a reconstructor that edits, with its editor."""
        if "editor" in self.registry.find(kind, choice.name).component.parts:
            return choice
        if kind not in self._built:
            self._built[kind] = self.registry.build_choice(kind, choice)
        return self._built[kind]


def evaluation_cameras(item: LoadedItem, predicted: Cameras) -> Cameras:
    """Return the inputs' predicted cameras, then those of the held-back frames.

    These stand at their true places relative to the reference, in the unit that makes the inputs'
    mean distance from it the true one; between the inputs where no pose is known.
    """
    count = len(item.record.held_back)
    if item.cameras is None:
        path = between_and_around(predicted, 2 * (count + 1))
        added = path.select(range(1, count + 1))
    else:
        true = item.cameras.to(predicted.c2w)
        inputs = true.select(range(item.inputs))
        held_back = true.select(range(item.inputs, true.count))
        unit = _mean_distance(predicted) / _mean_distance(inputs).clamp(min=1e-12)
        c2w = predicted.c2w[:, :1] @ scale_poses(held_back.c2w, unit)
        added = replace(held_back, c2w=c2w)
    return replace(
        predicted,
        c2w=torch.cat((predicted.c2w, added.c2w), 1),
        intrinsics=torch.cat((predicted.intrinsics, added.intrinsics), 1),
    )


def _mean_distance(cameras: Cameras) -> Float[Tensor, ""]:
    """Return the mean distance of the other cameras from the origin, where the first stands."""
    return cameras.c2w[:, 1:, :3, 3].norm(dim=-1).mean()


def save_sheet(file: Path, item: LoadedItem, output: MethodOutput) -> None:
    """Write photo, 2D edit, what the method shows, and truth of every frame on one sheet."""
    photos = item.photos.images[0]
    blank = torch.ones_like(photos[item.inputs :])  # held-back frames have no 2D edit
    columns = {
        "photo": photos,
        "2D edit": torch.cat((output.edited, blank)),
        "shown": output.images,
    }
    if output.has_truth and item.truth is not None:
        columns["truth"] = item.truth
    file.parent.mkdir(parents=True, exist_ok=True)
    sheet = draw_sheet(columns, names=item.photos.names, title=item.record.prompt)
    sheet.save(file, quality=90)
