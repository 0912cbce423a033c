"""From chosen photos with poses to a training sample: relative poses, unit baseline, mirrored half the time."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.cameras import relative_to_first
from edit3r.interfaces import SceneSample
from edit3r.types import Cameras

_MIRROR = torch.diag(torch.tensor([-1.0, 1, 1, 1]))


def make_sample(
    images: Float[Tensor, "view 3 height width"],
    c2w: Float[Tensor, "view 4 4"],
    intrinsics: Float[Tensor, "view 3 3"],
    context: int,
    name: str,
    rng: np.random.Generator,
    mirror: float,
    masks: Float[Tensor, "object view height width"] | None = None,
) -> SceneSample:
    """The first `context` views are context, the rest targets. Lengths are divided by the distance between the first
    and the last context camera; with probability `mirror` pictures, masks and poses are mirrored left to right."""
    poses = relative_to_first(c2w[None].double())[0]
    baseline = poses[context - 1, :3, 3].norm()
    poses[:, :3, 3] /= baseline.clamp(min=1e-9)
    poses = poses.float()
    if rng.random() < mirror:
        images = images.flip(-1)
        masks = None if masks is None else masks.flip(-1)
        poses = _MIRROR @ poses @ _MIRROR
        intrinsics = intrinsics.clone()
        intrinsics[:, 0, 2] = 1 - intrinsics[:, 0, 2]
    size = (images.shape[-2], images.shape[-1])
    return SceneSample(
        context=images[:context],
        target=images[context:],
        context_cameras=Cameras(poses[None, :context], intrinsics[None, :context], size),
        target_cameras=Cameras(poses[None, context:], intrinsics[None, context:], size),
        context_masks=None if masks is None else masks[:, :context],
        target_masks=None if masks is None else masks[:, context:],
        name=name,
    )
