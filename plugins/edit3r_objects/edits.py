"""Edits of some Gaussians of a scene (batch 1): moved, turned, scaled, painted."""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Bool
from torch import Tensor

from edit3r.contract.errors import PromptError
from edit3r.contract.interfaces import Editor
from edit3r.contract.types import Cameras, EditRequest, Gaussians, Views
from edit3r.kit import asking
from edit3r.kit.geometry.cameras import up_direction, upright
from edit3r.kit.geometry.harmonics import colour_to_dc, dc_to_colour, rotate_harmonics
from edit3r.kit.geometry.rotations import matrices_to_quats, quats_to_matrices
from edit3r.kit.scenes.axes import rotated
from edit3r.running import usual_reader

FOOT = 0.98  # quantile of y (down) at which a thing stands; no figure kept

Chosen = Bool[Tensor, "gaussian"]


def in_view_0(
    gaussians: Gaussians,
    chosen: Chosen,
    cameras: Cameras,
    up: Tensor | None,
    edit: Callable[[Gaussians], Gaussians],
) -> Gaussians:
    """The chosen Gaussians once edited in the frame of view 0, held upright where it is not the
    scene's own, as that of a splat of another program; `up` is known, or how it was held tells it.
    """
    c2w = cameras.c2w[0]
    if torch.equal(c2w[0], torch.eye(4)):
        return edit(gaussians).select(chosen)
    turn = upright(up_direction(c2w) if up is None else up, c2w[0, :3, :3])
    eye = c2w[0, :3, 3]
    shifted = replace(gaussians, means=gaussians.means - eye)
    own = rotated(edit(rotated(shifted, turn)).select(chosen), turn.T)
    return replace(own, means=own.means + eye)


def moved(gaussians: Gaussians, chosen: Chosen, steps: tuple[float, ...]) -> Gaussians:
    """`steps` to the right, up and toward view 0's viewer, as shares of the scene's depth.

    The depth is the median one of all Gaussians, seen from view 0.
    """
    depth = gaussians.means[0, :, 2].median()
    shift = depth * gaussians.means.new_tensor(steps) * torch.tensor([1.0, -1, -1])
    means = torch.where(chosen[:, None], gaussians.means + shift, gaussians.means)
    return replace(gaussians, means=means)


def scaled(gaussians: Gaussians, chosen: Chosen, factor: float) -> Gaussians:
    """The object larger (> 1) or smaller; the middle of its foot stays where it is."""
    own = gaussians.means[0, chosen]
    pivot = own.median(0).values
    pivot[1] = own[:, 1].quantile(FOOT)
    means = gaussians.means.clone()
    scales = gaussians.scales.clone()
    means[:, chosen] = pivot + factor * (own - pivot)
    scales[:, chosen] *= factor
    return replace(gaussians, means=means, scales=scales)


def turned(gaussians: Gaussians, chosen: Chosen, degrees: float) -> Gaussians:
    """The object about the up axis of view 0 through its centre; positive: its front to the right.

    Harmonics turn with it.
    """
    own = gaussians.select(chosen)
    angle = torch.deg2rad(torch.tensor(degrees))
    axis = torch.tensor([0.0, 1.0, 0.0]) * (angle / 2).sin()
    rotation = quats_to_matrices(torch.cat(((angle / 2).cos()[None], axis)))
    pivot = own.means[0].median(0).values
    changes = {
        "means": pivot + (own.means - pivot) @ rotation.T,
        "quats": matrices_to_quats(rotation @ quats_to_matrices(own.quats)),
        "harmonics": rotate_harmonics(own.harmonics, rotation),
    }
    new = {name: getattr(gaussians, name).clone() for name in changes}
    for name, values in changes.items():
        new[name][:, chosen] = values
    return replace(gaussians, **new)


def painted(
    gaussians: Gaussians, chosen: Chosen, colour: str, editor: Editor
) -> Gaussians:
    """The object in another colour, named as in a prompt; light and shade stay.

    The editor sees the Gaussians' colours as one image, a pixel each. What changes with direction
    loses its colour and keeps its light. Raises PromptError for what is not one colour.
    """
    harmonics = gaussians.harmonics.clone()
    own = harmonics[0, chosen]
    pixels = dc_to_colour(own[:, 0]).clamp(0, 1).T[None, None, :, None]
    views = Views(pixels.contiguous(), torch.eye(3)[None, None])
    prompt = f"paint the thing {colour}"
    request = EditRequest(prompt, instructions=usual_reader().read(prompt))
    if len(request.instructions) > 1:
        raise PromptError(f"recolor: expected one colour, got {colour!r}.")
    new = asking.edit(editor, views, request).images[0, 0, :, 0]
    own[:, 1:] = own[:, 1:].mean(-1, keepdim=True)
    own[:, 0] = colour_to_dc(new.T)
    harmonics[0, chosen] = own
    return replace(gaussians, harmonics=harmonics)
