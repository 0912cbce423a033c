"""What the four methods have in common around their own step: one scene at a time, the first fit, the last fit."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from edit3r.interfaces import Editor, Rasterizer, Reconstructor
from edit3r.reporting import note
from edit3r.types import Cameras, EditRequest, Gaussians, Reconstruction, Views
from edit3r_optimisers.checkpoints import Checkpoints
from edit3r_optimisers.fitting import FitPlan, Fitted, FixedPictures, Pictures, fit
from edit3r_optimisers.settings import FitSettings, MethodSettings
from edit3r_optimisers.starting_points import begin

__all__ = ["Scene", "Workshop", "each_scene"]


@dataclass(frozen=True)
class Scene:
    """One scene (batch 1) to edit."""

    photos: Views  # unedited
    edited: Views  # as the caller's editor made them; the photos themselves where it edited nothing
    request: EditRequest

    @property
    def is_edited(self) -> bool:
        return not torch.equal(self.photos.images, self.edited.images)


class Workshop:
    """The tools of one scene's fits."""

    def __init__(
        self, settings: MethodSettings, reconstructor: Reconstructor, editor: Editor, rasterizer: Rasterizer
    ) -> None:
        self.settings, self.reconstructor = settings, reconstructor
        self.editor, self.rasterizer = editor, rasterizer
        folder = Path(settings.checkpoint) if settings.checkpoint else None
        self.checkpoints = Checkpoints(folder, settings.checkpoint_every)

    def fit_photos(self, scene: Scene) -> tuple[Gaussians, Cameras]:
        """The unedited scene, and its cameras in the frame of view 0."""
        start = begin(scene.photos, self.reconstructor, self.settings)
        pictures = FixedPictures(scene.photos.images[0])
        fitted = self._fit("photos", start.gaussians, start.cameras, pictures, self.settings.steps, ())
        return fitted.gaussians, start.cameras

    def fit_edits(self, start: Gaussians, cameras: Cameras, pictures: Pictures, *made_from: object) -> Gaussians:
        """The scene fitted again, from `start`; `made_from` says what else decides how the pictures change."""
        return self._fit("edits", start, cameras, pictures, self.settings.edit_steps, made_from).gaussians

    def _fit(
        self, what: str, start: Gaussians, cameras: Cameras, pictures: Pictures, steps: int, made_from: tuple
    ) -> Fitted:
        chosen = {name: getattr(self.settings, name) for name in FitSettings.model_fields}
        plan = FitPlan(FitSettings(**chosen), steps, self.settings.seed, f"fit to the {what}")
        tensors = start.means, start.scales, start.quats, start.opacities, start.harmonics
        seen = cameras.c2w, cameras.intrinsics, pictures.images
        keeper = self.checkpoints.keeper(what, *tensors, *seen, sorted(chosen.items()), steps, plan.seed, *made_from)
        fitted = fit(start, cameras, pictures, self.rasterizer, plan, keeper)
        first, last = (sum(part) / len(part) for part in (fitted.losses[:10], fitted.losses[-10:]))
        facts = {"steps": steps, "gaussians": fitted.gaussians.count, "first_loss": first, "last_loss": last}
        note(f"refit.{what}", {key: round(value, 5) for key, value in facts.items()})
        return fitted


def each_scene(
    settings: MethodSettings,
    views: Views,
    source: Views | None,
    request: EditRequest | None,
    work: Callable[[Scene], tuple[Gaussians, Cameras]],
) -> Reconstruction:
    """Do `work` for every scene of the batch and join the results; the request's default is the settings' own."""
    photos = views if source is None else source
    if photos.c2w is None and views.c2w is not None:
        photos = replace(photos, c2w=views.c2w)
    request = request or EditRequest(settings.prompt, settings.seed)
    scenes = [
        Scene(_item(photos, b), _item(views, b), replace(request, masks=_part(request.masks, b)))
        for b in range(len(views.images))
    ]
    return _joined([work(scene) for scene in scenes])


def _item(views: Views, item: int) -> Views:
    return replace(
        views,
        images=views.images[item : item + 1],
        intrinsics=views.intrinsics[item : item + 1],
        c2w=_part(views.c2w, item),
    )


def _part(tensor: Tensor | None, item: int) -> Tensor | None:
    return None if tensor is None else tensor[item : item + 1]


def _joined(results: list[tuple[Gaussians, Cameras]]) -> Reconstruction:
    """One batch; scenes with fewer Gaussians are filled up with transparent ones."""
    most = max(gaussians.count for gaussians, _ in results)
    filled = [_filled(gaussians, most) for gaussians, _ in results]
    names = ("means", "scales", "quats", "opacities", "harmonics")
    fields = {name: torch.cat([getattr(gaussians, name) for gaussians in filled]) for name in names}
    # One index serves the whole batch, so scenes that were fitted apart have none.
    origin = filled[0].view_index if len(filled) == 1 else None
    cameras = [cameras for _, cameras in results]
    c2w, intrinsics = (torch.cat([getattr(c, name) for c in cameras]) for name in ("c2w", "intrinsics"))
    return Reconstruction(Gaussians(**fields, view_index=origin), Cameras(c2w, intrinsics, cameras[0].image_size))


def _filled(gaussians: Gaussians, count: int) -> Gaussians:
    """Transparent copies of the first Gaussian at the end, up to `count`."""
    missing = count - gaussians.count
    if missing == 0:
        return gaussians
    index = torch.cat((torch.arange(gaussians.count), torch.zeros(missing, dtype=torch.int64)))
    grown = gaussians.select(index.to(gaussians.means.device))
    shown = F.pad(torch.ones(gaussians.count), (0, missing)).to(grown.opacities)
    return replace(grown, opacities=grown.opacities * shown)
