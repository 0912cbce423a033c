"""The reconstructor `editsplat`: edits are fused across views and redone, attended Gaussians
trimmed, then a fit.

EditSplat (Lee et al. 2025): section 3.2 projects edited neighbours into a view and blends them;
section 3.3 carries attention maps of the edit to the Gaussians and prunes a share of the most
attended before the second fit.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.interfaces import Editor, GivesAttention, Rasterizer
from edit3r.contract.reporting import note, track
from edit3r.contract.types import Cameras, EditRequest, Gaussians, Views
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.warping import warp
from edit3r_optimisers.fitting import TargetImages
from edit3r_optimisers.method import (
    EditJob,
    FittingMethod,
    MethodSettings,
    depths_of,
    edited,
    edited_from,
)

DEPTH_TOLERANCE = 0.03
"""Relative difference of depths at which a neighbour's weight has fallen to exp(-1/2): it sees
another surface. No figure kept.
"""
OWN_WEIGHT = 0.25
"""Of the view's own edit beside its neighbours' weights of up to 1 each; it alone counts where no
neighbour looks. No figure kept.
"""


class EditSplatReconstructor(FittingMethod):
    """First edits are the views it is given, or its own where those are not edited.

    Each view is then edited again, starting from what its neighbours' edits look like from there.
    """

    class Settings(MethodSettings):
        neighbours: int = Field(5, ge=1, le=64)
        """nearest views fused into each (paper: 5)"""
        guidance: float = Field(0.5, ge=0, le=1)
        """share of the fused picture that an edit redraws; 0 takes it as it is"""
        trim: float = Field(0.15, ge=0, le=1)
        """share of the attended Gaussians that is removed"""
        attended: float = Field(0.5, ge=0, le=1)
        """attention from which a Gaussian counts as attended; the most is 1"""

    settings: Settings

    def _reconstruct(self, scene: EditJob) -> tuple[Gaussians, Cameras]:
        gaussians, cameras = self._fit_photos(scene)
        first = scene.edited
        if not scene.is_edited:
            first = edited(self.editor, scene.photos, scene.request)
        guided = self._guided(scene, first, gaussians, cameras)
        trimmed = self._trimmed(scene, guided, gaussians, cameras)
        targets = TargetImages(guided.images[0])
        return self._fit("edits", trimmed, cameras, targets), cameras

    def _guided(
        self, scene: EditJob, first: Views, gaussians: Gaussians, cameras: Cameras
    ) -> Views:
        """Edit every view again from the fusion of its neighbours' first edits."""
        depths, _ = depths_of(gaussians, cameras, self.rasterizer)
        images = first.images.clone()
        for view in track(range(first.count), "edit from fused neighbours"):
            around = nearest_views(cameras, view, self.settings.neighbours)
            start = fuse(view, around, first.images[0], depths, cameras)[0][None, None]
            photo, request = scene.photos.select([view]), scene.request.of_views([view])
            share = self.settings.guidance
            again = edited_from(self.editor, photo, start, request, share)
            images[:, [view]] = again.images
        return replace(first, images=images)

    def _trimmed(
        self, scene: EditJob, edits: Views, gaussians: Gaussians, cameras: Cameras
    ) -> Gaussians:
        """Remove the Gaussians that the edit attends to most, which hold back the second fit."""
        maps, told_by = attention_maps(self.editor, scene.photos, edits, scene.request)
        attention = attention_of(gaussians, cameras, maps, self.rasterizer)[0]
        kept = trim(attention, self.settings.trim, self.settings.attended)
        count = int((~kept).sum())
        note("editsplat.trimmed", {"gaussians": count, "attention_told_by": told_by})
        return gaussians.select(kept) if kept.any() else gaussians


def fuse(
    view: int,
    neighbours: list[int],
    edits: Float[Tensor, "view 3 height width"],
    depths: Float[Tensor, "view height width"],
    cameras: Cameras,
) -> tuple[Float[Tensor, "3 height width"], Float[Tensor, "height width"]]:
    """Project the edits of `neighbours` into `view` by depth and blend them with its own (section
    3.2).

    Returns the image and the summed weights of the neighbours, 0 where only the view's own edit
    counts. `depths` are camera z of the fitted scene. The paper chooses neighbours by ImageReward
    and the background by SAM, which need weights; here each counts by how exactly its surface is
    the one that the view sees.
    """
    points = unproject(depths[view], cameras.intrinsics[0, view], cameras.c2w[0, view])
    total, weights = OWN_WEIGHT * edits[view], torch.full_like(depths[view], OWN_WEIGHT)
    for other in neighbours:
        camera = cameras.select([other])
        colours, weight = _seen_from(points, edits[other], depths[other], camera)
        total, weights = total + weight * colours, weights + weight
    return total / weights, weights - OWN_WEIGHT


def nearest_views(cameras: Cameras, view: int, count: int) -> list[int]:
    """Return the `count` views whose cameras stand nearest, nearest first."""
    centres = cameras.c2w[0, :, :3, 3]
    order = (centres - centres[view]).norm(dim=-1).argsort(stable=True).tolist()
    return [other for other in order if other != view][:count]


def _seen_from(
    points: Float[Tensor, "height width 3"],
    edit: Float[Tensor, "3 height width"],
    depth: Float[Tensor, "height width"],
    camera: Cameras,
) -> tuple[Float[Tensor, "3 height width"], Float[Tensor, "height width"]]:
    """What one neighbour shows at the points of another view's pixels, with weights in [0, 1]."""
    lens, pose = camera.intrinsics[0, 0], camera.c2w[0, 0]
    coordinates, z = project(points.flatten(0, 1), lens, pose)
    coordinates, z = coordinates.view(*depth.shape, 2), z.view(depth.shape)
    sampled = warp(torch.cat((edit, depth[None])), coordinates)
    inside = (z > 0) & ((coordinates >= 0) & (coordinates <= 1)).all(-1)
    error = (sampled[3] - z) / (DEPTH_TOLERANCE * z.abs().clamp(min=1e-9))
    return sampled[:3], torch.exp(-0.5 * error.square()) * inside


def attention_maps(
    editor: Editor, photos: Views, edits: Views, request: EditRequest
) -> tuple[Float[Tensor, "batch view height width"], str]:
    """Return where the edit happens, in [0, 1] with the most at 1, and what tells it.

    That is the editor's own attention; else the masks; else how much each pixel changed.
    """
    if isinstance(editor, GivesAttention):
        maps = editor.attention(photos, request)
        told_by = "the editor's cross-attention"
    elif request.masks is not None:
        maps, told_by = request.masks, "the masks; the editor gives no attention"
    else:
        maps = (edits.images - photos.images).abs().mean(2)
        told_by = "the change of each pixel, no attention or masks"
    return maps / maps.amax().clamp(min=1e-12), told_by


def attention_of(
    gaussians: Gaussians,
    cameras: Cameras,
    maps: Float[Tensor, "batch view h w"],
    rasterizer: Rasterizer,
) -> Float[Tensor, "batch gaussian"]:
    """Return the mean of the maps over the pixels of each Gaussian, weighted by transmittance times
    alpha.

    It is 0 for a Gaussian that no pixel shows.
    """
    weights = torch.stack((maps[0], torch.ones_like(maps[0])), 1)
    sums = rasterizer.contributions(gaussians, cameras, weights)
    attended, drawn = sums.unbind(-1)
    return torch.where(drawn > 1e-6, attended / drawn.clamp(min=1e-6), 0.0)


def trim(
    attention: Float[Tensor, "gaussian"], share: float, threshold: float
) -> Bool[Tensor, "gaussian"]:
    """Keep all but the most attended `share` of those attended by `threshold` or more (3.3)."""
    attended = attention >= threshold
    count = round(share * int(attended.sum()))
    order = torch.where(attended, attention, -1.0).argsort(descending=True, stable=True)
    kept = torch.ones_like(attended)
    kept[order[:count]] = False
    return kept
