"""Adding Gaussians where the scene is not drawn well yet and removing those that draw nothing.

3D Gaussian Splatting, section 5.2: where the loss still pulls a Gaussian across the picture, a small one is cloned
and a large one is split in two; transparent ones, and after opacities were reset also huge ones, are removed.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import invert_rigid, project
from edit3r.geometry.rotations import quats_to_matrices
from edit3r.types import Cameras
from edit3r_optimisers.cloud import Cloud, Rows
from edit3r_optimisers.settings import FitSettings

__all__ = ["Growth", "control", "is_due", "is_watching", "must_reset", "pull_in_picture", "split"]

CHILDREN = 2
SHRINKING = 1.6  # a child's scales are its parent's over this
RESET_OPACITY = 0.01


@dataclass
class Growth:
    """What steps since the last control told about each Gaussian."""

    pull: Float[Tensor, "gaussian"]  # sum of gradients by the place in the picture [loss per half picture]
    seen: Float[Tensor, "gaussian"]  # steps in which it lay in the picture
    footprint: Float[Tensor, "gaussian"]  # largest standard deviation in a picture [picture widths]

    @staticmethod
    def of(count: int, like: Tensor) -> "Growth":
        return Growth(*(like.new_zeros(count) for _ in range(3)))

    @torch.no_grad()
    def add(self, rows: Rows, gradient: Float[Tensor, "gaussian 3"], camera: Cameras) -> None:
        """Count one step that looked through `camera` (one) and found `gradient` of the loss by the centres."""
        places, z = project(rows.means, camera.intrinsics[0, 0], camera.c2w[0, 0])
        visible = (z > 0) & ((places >= 0) & (places <= 1)).all(-1)
        self.pull += torch.where(visible, pull_in_picture(rows.means, gradient, camera), 0.0)
        self.seen += visible
        width = rows.scales.exp().amax(-1) * camera.intrinsics[0, 0, 0, 0] / z
        self.footprint = torch.where(visible, torch.maximum(self.footprint, width), self.footprint)

    @property
    def mean_pull(self) -> Float[Tensor, "gaussian"]:
        return self.pull / self.seen.clamp(min=1)


def pull_in_picture(
    means: Float[Tensor, "gaussian 3"], gradient: Float[Tensor, "gaussian 3"], camera: Cameras
) -> Float[Tensor, "gaussian"]:
    """Length of the loss's gradient by a Gaussian's place in the picture, in half picture sides (the paper's NDC).

    Moving a centre sideways by dx moves it by 2 f dx / z half pictures (f in picture widths or heights), so the
    gradient by the place is the one by the centre, in the camera's axes, times z / (2 f). Rasterizers need not tell it.
    """
    w2c = invert_rigid(camera.c2w[0, 0])
    z = means @ w2c[2, :3] + w2c[2, 3]
    sideways = gradient @ w2c[:2, :3].T
    focal = camera.intrinsics[0, 0, [0, 1], [0, 1]]
    return (sideways * z[:, None] / (2 * focal)).norm(dim=-1)


def is_due(settings: FitSettings, done: int, steps: int) -> bool:
    """Whether Gaussians are added and removed after `done` of `steps` steps."""
    late = done > settings.densify_until * steps
    return done > settings.densify_from and not late and done % settings.densify_every == 0


def is_watching(settings: FitSettings, done: int, steps: int) -> bool:
    """Whether a control is still to come that step `done` tells something for."""
    last = settings.densify_until * steps
    return done <= last and settings.densify_from < last


def must_reset(settings: FitSettings, done: int, steps: int) -> bool:
    """Whether opacities are reset after `done` of `steps` steps."""
    every = settings.reset_every
    return every > 0 and done % every == 0 and done <= settings.densify_until * steps


@torch.no_grad()
def control(cloud: Cloud, growth: Growth, settings: FitSettings, extent: float, done: int, seed: int) -> None:
    """Clone, split and remove; `growth` no longer fits the cloud afterwards."""
    hot = _hottest(growth.mean_pull, settings.grow_gradient, settings.most - len(cloud))
    large = cloud.rows.scales.exp().amax(-1) > settings.split_size * extent
    footprint = growth.footprint
    chosen = hot & ~large
    cloud.append(cloud.rows[chosen], cloud.origin[chosen])
    parents = _padded(hot & large, len(cloud))
    generator = torch.Generator().manual_seed((seed * 1_000_003 + done) % 2**63)
    cloud.append(split(cloud.rows[parents], generator), cloud.origin[parents].repeat(CHILDREN))
    kept = ~_padded(parents, len(cloud)) & ~_superfluous(cloud, footprint, settings, extent, done)
    if kept.any():
        cloud.keep(kept)


def split(parents: Rows, generator: torch.Generator) -> Rows:
    """Two children each, drawn from the parent as a distribution, smaller by 1.6."""
    scales = parents.scales.exp().repeat(CHILDREN, 1)
    offsets = torch.randn(scales.shape, generator=generator, dtype=scales.dtype).to(scales) * scales
    turned = (quats_to_matrices(parents.quats).repeat(CHILDREN, 1, 1) @ offsets[..., None])[..., 0]
    repeated = {n: v.repeat(CHILDREN, *[1] * (v.ndim - 1)) for n, v in vars(parents).items()}
    repeated["means"] = repeated["means"] + turned
    repeated["scales"] = (scales / SHRINKING).log()
    return Rows(**repeated)


def _hottest(pull: Float[Tensor, "gaussian"], threshold: float, room: int) -> Bool[Tensor, "gaussian"]:
    """Those at or above the threshold, the `room` most pulled of them where there are more."""
    hot = pull >= threshold
    if int(hot.sum()) > max(0, room):
        order = torch.where(hot, pull, -1.0).argsort(descending=True, stable=True)
        hot = torch.zeros_like(hot)
        hot[order[: max(0, room)]] = True
    return hot


def _superfluous(
    cloud: Cloud, footprint: Float[Tensor, "old"], settings: FitSettings, extent: float, done: int
) -> Bool[Tensor, "gaussian"]:
    """Transparent Gaussians; once opacities were reset also those too large in the world or in a picture."""
    rows = cloud.rows
    gone = rows.opacities.sigmoid() < settings.prune_opacity
    if settings.reset_every and done > settings.reset_every:
        gone = gone | (rows.scales.exp().amax(-1) > settings.prune_world * extent)
        gone = gone | _padded(footprint > settings.prune_view, len(cloud))
    return gone


def _padded(mask: Bool[Tensor, "old"], count: int) -> Bool[Tensor, "count"]:
    """The mask for a cloud that has grown since, False for what was added."""
    return torch.cat((mask, mask.new_zeros(count - len(mask))))
