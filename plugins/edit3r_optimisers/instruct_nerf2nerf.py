"""The reconstructor `instruct-nerf2nerf`: edits trickle into the pictures while the scene is fitted to them."""

import torch
from pydantic import Field, model_validator

from edit3r.interfaces import Editor
from edit3r.reporting import note
from edit3r.types import Cameras, Gaussians
from edit3r_optimisers.dataset_update import Renewal, RenewedPictures
from edit3r_optimisers.method import FittingMethod
from edit3r_optimisers.scenes import Scene
from edit3r_optimisers.settings import MethodSettings

__all__ = ["InstructNerf2NerfReconstructor"]


class InstructNerf2NerfReconstructor(FittingMethod):
    """Iterative dataset update on Gaussians instead of a NeRF (Haque et al. 2023).

    It edits by itself: the edited views it is given are not looked at, only the photos before editing. Real partial
    denoising needs an editor that can start from a picture (instruct-pix2pix); others are mixed in, which the run says.
    """

    class Settings(MethodSettings):
        every: int = Field(10, ge=1, description="steps between edits (paper: 10)")
        views_at_once: int = Field(1, ge=1, description="views edited each time (paper: 1)")
        least_strength: float = Field(0.5, ge=0, le=1, description="least share of a render that an edit redraws")
        most_strength: float = Field(0.98, ge=0, le=1, description="most share of a render that an edit redraws")
        fresh_noise: bool = Field(True, description="another seed for every edit, as published")

        @model_validator(mode="after")
        def _ordered(self) -> "InstructNerf2NerfReconstructor.Settings":
            if self.least_strength > self.most_strength:
                raise ValueError(
                    f"least_strength ({self.least_strength}) must not be above most_strength ({self.most_strength})"
                )
            return self

    @torch.no_grad()
    def _scene(self, scene: Scene) -> tuple[Gaussians, Cameras]:
        workshop = self.workshop()
        gaussians, cameras = workshop.fit_photos(scene)
        chosen = self.settings
        strengths = (chosen.least_strength, chosen.most_strength)
        renewal = Renewal(chosen.every, chosen.views_at_once, strengths, chosen.fresh_noise)
        pictures = RenewedPictures(scene.photos, cameras, scene.request, renewal, self.editor, self.rasterizer)
        asked = scene.request.prompt, scene.request.seed, scene.request.masks
        gaussians = workshop.fit_edits(gaussians, cameras, pictures, *asked, renewal, *_identity(self.editor))
        note("refit.edits_of_the_dataset", pictures.renewals)
        workshop.checkpoints.discard()
        return gaussians, cameras


def _identity(editor: Editor) -> tuple[str, str]:
    """Which editor it is, so that a checkpoint made with another is not taken up."""
    return type(editor).__qualname__, repr(getattr(editor, "settings", None))
