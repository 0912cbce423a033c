"""What the methods ask the editor: edits confined to the masks, edits that begin from an image, renders to edit."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.interfaces import Editor, Rasterizer
from edit3r.pipeline import composite
from edit3r.reporting import warn
from edit3r.stage_checks import check_edit, component_name, errors_named_after
from edit3r.types import Cameras, EditRequest, Gaussians, Views


@torch.no_grad()
def edited(editor: Editor, views: Views, request: EditRequest) -> Views:
    """Edit the views; the answer is held to the editor's contract and confined to the request's masks."""
    with errors_named_after(editor):
        answer = editor.edit(views, request)
    return _confined(editor, views, answer, request)


@torch.no_grad()
def edited_from(
    editor: Editor,
    views: Views,
    start: Float[Tensor, "batch view 3 height width"],
    request: EditRequest,
    strength: float,
) -> Views:
    """Edit `views`, beginning from the images `start`; `strength` in [0, 1] says how little of them stays.

    An editor that cannot begin from images edits anew, and its result is mixed with them; the run says so.
    """
    if editor.starts_from_images:
        with errors_named_after(editor):
            answer = editor.edit_from(views, start, request, strength)
        return _confined(editor, views, answer, request)
    warn(
        f"editor {component_name(editor)!r} cannot start from a given picture, so each new edit is mixed with it: "
        "a stand-in for the partial denoising of the published method."
    )
    anew = edited(editor, views, request)
    mixed = torch.lerp(start.clamp(0, 1), anew.images, strength)
    return _confined(editor, views, replace(views, images=mixed), request)


def _confined(editor: Editor, views: Views, answer: Views, request: EditRequest) -> Views:
    """Check the editor's answer and keep it inside the request's masks."""
    check_edit(editor, views, answer)
    if request.masks is None:
        return replace(views, images=answer.images)
    return replace(views, images=composite(views.images, answer.images, request.masks))


@torch.no_grad()
def rendered(gaussians: Gaussians, cameras: Cameras, photos: Views, rasterizer: Rasterizer) -> Views:
    """Return the views as the fitted scene shows them."""
    return replace(photos, images=rasterizer.render(gaussians, cameras).images.clamp(0, 1), c2w=cameras.c2w)


@torch.no_grad()
def depths_of(
    gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer
) -> tuple[Float[Tensor, "view height width"], Float[Tensor, "view height width"]]:
    """Return camera z of every pixel of one scene, and its alpha.

    Where a pixel shows nothing, z is the farthest depth of that view.
    """
    seen = rasterizer.render(gaussians, cameras)
    depths, alphas = seen.depths[0, :, 0], seen.alphas[0, :, 0]
    farthest = depths.amax((1, 2), keepdim=True).clamp(min=1e-6)
    return torch.where(depths > 0, depths, farthest), alphas
