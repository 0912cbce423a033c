"""Raw network maps to Gaussians: the activations of centre, scale, rotation, opacity and colour.

Pure functions, always in float32 or wider. The parametrisation is that of Ye et al., No Pose, No
Problem (ICLR 2025).
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import Gaussians

MAX_DISTANCE_EXPONENT = 40.0
"""Raw distances are cut here: e^40 is beyond any scene, and its square is still a float32.
A sanity limit.
"""
MIN_SCALE = 1e-12
"""Keeps scales positive where softplus underflows [scene units]."""
MAX_SCALE = 0.3
"""As in NoPoSplat [scene units]."""
MIN_QUAT = 1e-6
"""Shorter raw quaternions have no direction to speak of; dividing by their length would make
gradients explode.
"""


Vectors = Float[Tensor, "*batch 3"]
Maps = Float[Tensor, "batch view channel height width"]


def centres(raw: Vectors) -> Vectors:
    """Points e^|raw| - 1 along `raw`, in the frame of view 0; z may be negative."""
    length = raw.norm(dim=-1, keepdim=True)
    distance = torch.expm1(length.clamp(max=MAX_DISTANCE_EXPONENT))
    return raw / length.clamp(min=1e-8) * distance


def quats_from_xyzw(raw: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Unit wxyz of raw x, y, z, w; shorter than `MIN_QUAT`: zero (no rotation, no gradient)."""
    norm = raw.norm(dim=-1, keepdim=True)
    unit = raw / (norm.clamp(min=MIN_QUAT) + 1e-8)
    return torch.where(norm > MIN_QUAT, unit, torch.zeros_like(unit)).roll(1, -1)


def harmonics_mask(degree: int, like: Tensor) -> Float[Tensor, "coefficient"]:
    """Return the fixed damping of view dependence: 1 for l = 0, 0.1 * 0.25^l for higher l."""
    factors = [1.0]
    for level in range(1, degree + 1):
        factors += [0.1 * 0.25**level] * (2 * level + 1)
    return like.new_tensor(factors)


def attribute_channels(degree: int) -> int:
    """Channels of an attribute map: opacity, three scales, four of quaternions, harmonics."""
    return 8 + 3 * (degree + 1) ** 2


def adapt(
    points: Float[Tensor, "batch view 3 height width"],
    attributes: Maps,
    scale_factor: float,
    degree: int,
) -> Gaussians:
    """One Gaussian per pixel of raw maps, view-major, row-major, with harmonics up to `degree`."""
    raw = _per_pixel(attributes)
    opacity, scale, quat, colour = raw.split((1, 3, 4, raw.shape[-1] - 8), -1)
    # [batch, gaussian, coefficient, 3]
    harmonics = colour.unflatten(-1, (3, -1)).transpose(-1, -2)
    kept = (degree + 1) ** 2
    view_index = torch.arange(points.shape[1], device=points.device)
    return Gaussians(
        means=centres(_per_pixel(points)),
        scales=(scale_factor * F.softplus(scale)).clamp(MIN_SCALE, MAX_SCALE),
        quats=quats_from_xyzw(quat),
        opacities=opacity.squeeze(-1).sigmoid(),
        harmonics=harmonics[..., :kept, :] * harmonics_mask(degree, raw)[:, None],
        view_index=view_index.repeat_interleave(points[0, 0, 0].numel()),
    )


def _per_pixel(maps: Maps) -> Float[Tensor, "batch gaussian channel"]:
    """Maps to one row per pixel, in float32 at least."""
    wide = maps.float() if maps.dtype in (torch.float16, torch.bfloat16) else maps
    return wide.movedim(2, -1).flatten(1, 3)
