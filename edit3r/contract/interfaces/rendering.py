"""Rasterizers."""

import functools
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.errors import InputError
from edit3r.contract.torch_state import Function, in_usual_torch
from edit3r.contract.types import DC, Cameras, Gaussians, Rendering

OFF = 0.01
"""How far what must be 0 or 1 in a camera may be off. A sanity limit."""


def _with_cameras(render: Function) -> Function:
    """The method, which raises InputError for cameras that are none: it would draw them wrongly."""

    @functools.wraps(render)
    def checked(
        self: Any, gaussians: Gaussians, cameras: Cameras, *more: Any, **named: Any
    ) -> Any:
        _check_cameras(cameras)
        return render(self, gaussians, cameras, *more, **named)

    return checked  # type: ignore[return-value]


def _beside(lens: Tensor) -> Tensor:
    """What must be 0 in intrinsics."""
    last = lens[..., 2, :] - lens.new_tensor((0, 0, 1))
    return torch.cat((lens[..., 0, 1:2], lens[..., 1, :1], last), -1)


def _check_cameras(cameras: Cameras) -> None:
    lens, pose = cameras.intrinsics.detach(), cameras.c2w.detach()
    focal = lens[..., :2, :2].diagonal(dim1=-2, dim2=-1)
    if lens.is_meta or not (focal > 0).all():  # which a rasterizer tells of itself
        return
    axes = pose[..., :3, :3]
    off = {
        "intrinsics have skew, or no last row 0, 0, 1": _beside(lens),
        "c2w has no last row 0, 0, 0, 1": pose[..., 3, :]
        - pose.new_tensor((0, 0, 0, 1)),
        "the axes of c2w are no rotation": axes.mT @ axes - torch.eye(3).to(axes),
    }
    for fault, values in off.items():
        if not (values.abs() <= OFF).all():
            raise InputError(
                f"Cameras: {fault}; expected a pinhole camera, and where it stands."
            )


class Rasterizer(Configured, ABC):
    """Renders Gaussians; differentiable in means, quats, scales, opacities and harmonics."""

    gives: tuple[str, ...] = ("images", "alphas", "depths")
    """What its renderings hold: some of these, and what it adds to `Rendering.extra` by name, such
    as "normals". A run needs these three, and says so of a rasterizer that lacks one before any
    work.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name in {"render", "contributions"} & vars(cls).keys():
            setattr(cls, name, in_usual_torch(_with_cameras(getattr(cls, name))))

    @abstractmethod
    def render(self, gaussians: Gaussians, cameras: Cameras) -> Rendering:
        """What it `gives` of every camera of every scene."""

    def prepare(self, device: str) -> None:
        """Begin in the background what would delay the first image, such as compiling.

        A run calls it before the photos are edited, with the type of device that the Gaussians
        will be on, such as 'cpu'. This default does nothing.
        """

    @in_usual_torch
    def contributions(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        weights: Float[Tensor, "camera *map height width"] | None = None,
    ) -> Float[Tensor, "batch gaussian *map"]:
        """Each Gaussian's blending weight (transmittance times alpha), summed over all pixels.

        `weights` says how much each pixel counts, in one map or in up to three, each of which has
        its own sums; None: 1 each. Not differentiable. This default
        reads them from the gradient of `render`; a rasterizer without gradients overrides it.
        """
        # An image is linear in the colours, so the gradient of its sum by the constant harmonic is
        # the weight times the basis function. Grey Gaussians stay away from the clamp at 0.
        grey = torch.zeros_like(gaussians.harmonics[:, :, :1]).requires_grad_(True)
        grey_gaussians = replace(gaussians, harmonics=grey)
        maps = torch.Size() if weights is None else weights.shape[1:-2]
        channels = maps.numel()
        total = torch.zeros_like(gaussians.means[..., :channels])
        # one by one: a graph of all takes a lot of memory
        for camera in range(cameras.count):
            with torch.enable_grad():
                images = self.render(grey_gaussians, cameras.select([camera])).images
                counted = images[:, 0, :channels]
                if weights is not None:
                    counted = counted * weights[camera]
                gradient = torch.autograd.grad(counted.sum(), grey)[0]
                total += gradient[:, :, 0, :channels]
        return (total / DC).view(*total.shape[:2], *maps)
