"""The reconstructor `editsplat`: edits are fused across views and redone, attended Gaussians trimmed, then a fit."""

from dataclasses import replace

import torch
from pydantic import Field

from edit3r.reporting import note, track
from edit3r.types import Cameras, Gaussians, Views
from edit3r_optimisers.edits import edited, edited_from, for_views
from edit3r_optimisers.fitting import FixedPictures
from edit3r_optimisers.fusion import fuse, nearest_views
from edit3r_optimisers.method import FittingMethod
from edit3r_optimisers.renders import depths_of
from edit3r_optimisers.scenes import Scene
from edit3r_optimisers.settings import MethodSettings
from edit3r_optimisers.trimming import attention_maps, attention_of, trim

__all__ = ["EditSplatReconstructor"]


class EditSplatReconstructor(FittingMethod):
    """Multi-view fusion guidance and attention-guided trimming (Lee et al. 2025) around a second fit.

    First edits are the views it is given, or its own where those are not edited. Each view is then edited again,
    starting from what its neighbours' edits look like from there.
    """

    class Settings(MethodSettings):
        neighbours: int = Field(5, ge=1, le=64, description="nearest views fused into each (paper: 5)")
        guidance: float = Field(
            0.5, ge=0, le=1, description="share of the fused picture that an edit redraws; 0 takes it as it is"
        )
        trim: float = Field(0.15, ge=0, le=1, description="share of the attended Gaussians that is removed")
        attended: float = Field(
            0.5, ge=0, le=1, description="attention from which a Gaussian counts as attended; the most is 1"
        )

    @torch.no_grad()
    def _scene(self, scene: Scene) -> tuple[Gaussians, Cameras]:
        workshop = self.workshop()
        gaussians, cameras = workshop.fit_photos(scene)
        first = scene.edited if scene.is_edited else edited(self.editor, scene.photos, scene.request)
        guided = self._guided(scene, first, gaussians, cameras)
        trimmed = self._trimmed(scene, guided, gaussians, cameras)
        gaussians = workshop.fit_edits(trimmed, cameras, FixedPictures(guided.images[0]))
        workshop.checkpoints.discard()
        return gaussians, cameras

    def _guided(self, scene: Scene, first: Views, gaussians: Gaussians, cameras: Cameras) -> Views:
        """Every view edited again from the fusion of its neighbours' first edits."""
        depths, _ = depths_of(gaussians, cameras, self.rasterizer)
        images = first.images.clone()
        for view in track(range(first.count), "edit from fused neighbours"):
            around = nearest_views(cameras, view, self.settings.neighbours)
            start = fuse(view, around, first.images[0], depths, cameras).image[None, None]
            photo, request = scene.photos.select([view]), for_views(scene.request, [view])
            images[:, [view]] = edited_from(self.editor, photo, start, request, self.settings.guidance).images
        return replace(first, images=images)

    def _trimmed(self, scene: Scene, edits: Views, gaussians: Gaussians, cameras: Cameras) -> Gaussians:
        maps, told_by = attention_maps(self.editor, scene.photos, edits, scene.request)
        attention = attention_of(gaussians, cameras, maps, self.rasterizer)[0]
        kept = trim(attention, self.settings.trim, self.settings.attended)
        note("editsplat.trimmed", {"gaussians": int((~kept).sum()), "attention_told_by": told_by})
        return gaussians.select(kept) if kept.any() else gaussians
