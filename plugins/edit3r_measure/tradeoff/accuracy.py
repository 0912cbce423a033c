"""How good a finished run folder is, against the truth of its scene: the novel view, and what became of an edit."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from edit3r.errors import MissingDependencyError
from edit3r.interfaces import Loss, LossInputs, Rasterizer
from edit3r.io.cameras import read_scene_cameras
from edit3r.io.ply import load_ply
from edit3r.io.posed_folder import Photo
from edit3r.io.run_folder import RunFolder
from edit3r.registry import Registry
from edit3r.types import Reconstruction
from edit3r_measure.evaluation.metrics import psnr, ssim
from edit3r_measure.evaluation.novel_view import predict
from edit3r_measure.tradeoff.scenes import MeasuredScene

CHANGED = 2 / 255
"""Mean change of colour above which a pixel of the target belongs to the true edit."""


@dataclass(frozen=True)
class NovelView:
    """The target as the run's scene shows it at its true pose, in the unit that the true baseline gives."""

    image: np.ndarray  # [height, width, 3] sRGB in [0, 1]
    covered: np.ndarray  # [height, width] bool


@dataclass(frozen=True)
class EditScore:
    """What became of a true edit on the novel view; changes are against the run without an edit."""

    uptake: float | None  # projection of the shown change on the true one, where the edit is; 1 is all; None: unseen
    leak: float | None  # mean absolute change elsewhere [sRGB]; None: there is no elsewhere
    psnr: float  # of the edited novel view against its truth [dB]


def novel_view(folder: Path, scene: MeasuredScene, rasterizer: Rasterizer) -> NovelView:
    """Render the target from the scene of a run, at the target's own size."""
    run = RunFolder(folder)
    cameras, posed = read_scene_cameras(run.cameras)
    inputs, target = scene.truth()
    names = [file.stem for file in scene.photos]
    used = [inputs[names.index(Path(camera.file).stem)] for camera in posed]
    reconstruction = Reconstruction(load_ply(run.scene), cameras)
    return NovelView(*predict(reconstruction, rasterizer, used[0], used[1], target))


def score_edit(plain: NovelView, edited: NovelView, before: Photo, after: Photo) -> EditScore:
    """Uptake and leak of the edit that turned the target `before` into `after`."""
    true, shown = after.image - before.image, edited.image - plain.image
    covered = plain.covered & edited.covered
    inside = covered & (np.abs(true).mean(-1) > CHANGED)
    outside = covered & (true == 0).all(-1)
    return EditScore(
        uptake=float((shown * true)[inside].sum() / np.square(true)[inside].sum()) if inside.any() else None,
        leak=float(np.abs(shown[outside]).mean()) if outside.any() else None,
        psnr=psnr(edited.image, after.image),
    )


def score_picture(view: NovelView, target: Photo) -> dict[str, float]:
    """PSNR [dB] and SSIM of the whole picture, and the share of it that is covered."""
    return {
        "psnr": psnr(view.image, target.image),
        "ssim": ssim(view.image, target.image),
        "coverage": float(view.covered.mean()),
    }


class PerceptualDistance:
    """The first of some losses that can be had here; `why_not` says what each of the others lacks."""

    def __init__(self, registry: Registry, names: Sequence[str]) -> None:
        self.name: str | None = None
        self.why_not: dict[str, str] = {}
        self._loss: Loss | None = None
        for name in names:
            try:
                self._loss, self.name = registry.build("loss", name), name
                return
            except MissingDependencyError as error:
                self.why_not[name] = str(error)

    def __call__(self, image: np.ndarray, target: np.ndarray) -> float | None:
        """Distance of two pictures `[height, width, 3]` in [0, 1]; None where no loss is to be had."""
        if self._loss is None:
            return None
        rendered, wished = (torch.from_numpy(x).permute(2, 0, 1)[None, None] for x in (image, target))
        with torch.no_grad():
            return float(self._loss(LossInputs(rendered=rendered, target=wished)))
