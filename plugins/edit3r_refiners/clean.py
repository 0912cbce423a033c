"""Take floaters out of a finished scene: what hangs in the air before everything that cameras see.

A Gaussian is a floater where each camera that has it in the picture sees a surface clearly behind
it: it veils, and is the surface of nothing. What one camera sees as its surface stays, and so does
what stands behind the surfaces, and what veils so much together that little is seen behind.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Rasterizer, RefineInputs, Refiner
from edit3r.contract.reporting import note, progress
from edit3r.contract.settings import Settings
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.kit import asking
from edit3r.kit.compute.layers import one_thread
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.warping import warp

# The numbers of this block: docs/notes/simplify.md.
OPAQUE = 0.5  # a pixel that is less so shows no surface
SEEN = 2 / 255  # change of a pixel's colour that counts as one [sRGB]
# Opacity of floaters together from which they are what a pixel shows: rendered depths are means, so
# that before a far sky a half opaque house stands clearly before its own depth.
SOLID = 0.75


class CleanSettings(Settings):
    """What counts as hanging before a surface."""

    in_front: float = Field(0.1, gt=0, lt=1)
    """share of the surface's depth by which a floater stands before it"""
    beside: float = Field(3 / 256, ge=0, le=0.1)
    """the nearest surface so far around counts: what frays beside an edge stays [long sides]"""


@dataclass(frozen=True)
class Floaters:
    """Which Gaussians of a scene are floaters, and what the scene is without them."""

    found: Bool[Tensor, "gaussian"]
    # share of the cameras' pixels that change by more than 2 of 255 levels without them
    changed: float

    @property
    def sentence(self) -> str:
        """What taking them out would do, for people."""
        count, all_of_them = int(self.found.sum()), len(self.found)
        if not count:
            return "No floaters: each Gaussian is part of, or behind, what some camera sees."
        many = count != 1
        return (
            f"{count:,} of {all_of_them:,} Gaussians {'are floaters' if many else 'is a floater'}: "
            f"every camera that has {'them' if many else 'it'} in the picture sees past "
            f"{'them' if many else 'it'}. Without {'them' if many else 'it'} {self.changed:.1%} of "
            "the cameras' pixels change visibly."
        )


@torch.no_grad()
@one_thread()
def find_floaters(
    gaussians: Gaussians,
    cameras: Cameras,
    rasterizer: Rasterizer,
    settings: CleanSettings | None = None,
) -> Floaters:
    """Find the floaters of one scene (batch 1) as seen from `cameras`; the scene stays as it is.

    `gaussians.select(~floaters.found)` is the scene without them. What is opaque from all sides is
    a thing, wherever it stands, and no floater. Raises InputError for a batch of several scenes.
    """
    settings = settings or CleanSettings()
    if gaussians.means.shape[0] != 1:
        raise InputError(
            f"clean takes one scene at a time, got a batch of {gaussians.means.shape[0]}."
        )
    before = torch.zeros(
        gaussians.count, dtype=torch.bool, device=gaussians.means.device
    )
    elsewhere, shown = before.clone(), []
    for view in range(cameras.count):
        camera = cameras.select([view])
        rendering = asking.render(rasterizer, gaussians, camera)
        places, depth = project(
            gaussians.means[0], camera.intrinsics[0, 0], camera.c2w[0, 0]
        )
        nearest = _nearest_surface(rendering, settings.beside)
        surface = warp(nearest, places[None, None], mode="nearest", padding="zeros")
        surface = surface[0, 0, 0]
        there = (depth > 0) & (surface > 0)
        in_front = depth < (1 - settings.in_front) * surface
        before |= there & in_front
        elsewhere |= there & ~in_front
        shown.append(rendering.images.clamp(0, 1))
        progress("look for floaters", view + 1, cameras.count)
    floating = _veiling(before & ~elsewhere, gaussians, cameras, rasterizer)
    if not floating.any():
        return Floaters(floating, 0.0)
    rest = gaussians.select(~floating)
    changed = [
        _changed(image, asking.render(rasterizer, rest, cameras.select([view])))
        for view, image in enumerate(shown)
    ]
    return Floaters(floating, sum(changed) / len(changed))


def _veiling(
    candidates: Bool[Tensor, "gaussian"],
    gaussians: Gaussians,
    cameras: Cameras,
    rasterizer: Rasterizer,
) -> Bool[Tensor, "gaussian"]:
    """The candidates that veil: where together they are solid for a camera, they are a surface."""
    left = candidates.clone()
    for view in range(cameras.count if candidates.any() else 0):
        camera = cameras.select([view])
        veil = asking.render(rasterizer, gaussians.select(candidates), camera).alphas
        places, depth = project(
            gaussians.means[0], camera.intrinsics[0, 0], camera.c2w[0, 0]
        )
        size = veil.shape[-2:]
        opacity = warp(
            veil.reshape(1, 1, *size),
            places[None, None],
            mode="nearest",
            padding="zeros",
        )
        left &= ~((depth > 0) & (opacity[0, 0, 0] > SOLID))
    return left


def _nearest_surface(
    rendering: Rendering, beside: float
) -> Float[Tensor, "1 1 height width"]:
    """Camera z of the nearest surface around each pixel; 0: none."""
    size = rendering.depths.shape[-2:]
    depths = rendering.depths.reshape(1, 1, *size)
    surface = (rendering.alphas.reshape(1, 1, *size) > OPAQUE) & (depths > 0)
    reach = round(beside * max(size))
    far = torch.where(surface, depths, torch.inf)
    nearest = -F.max_pool2d(-far, 2 * reach + 1, 1, reach)
    return torch.where(nearest.isfinite(), nearest, torch.zeros_like(nearest))


def _changed(images: Tensor, rendering: Rendering) -> float:
    """Share of the pixels whose colour is seen to change."""
    change = (images - rendering.images.clamp(0, 1)).abs().amax(2)
    return float((change > SEEN).float().mean())


class CleanRefiner(Refiner):
    """Takes out floaters: what hangs before everything that the cameras see."""

    class Settings(CleanSettings):
        pass

    settings: Settings

    def __call__(self, gaussians: Gaussians, inputs: RefineInputs) -> Gaussians:
        """The scene without its floaters, which are counted in the notes."""
        floaters = find_floaters(
            gaussians, inputs.cameras, inputs.rasterizer, self.settings
        )
        note(
            "clean",
            {"taken": int(floaters.found.sum()), "changed": round(floaters.changed, 4)},
        )
        return gaussians.select(~floaters.found)
