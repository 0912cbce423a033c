"""How the methods call the editor: its contract is kept, masks confine it, and it may start from another picture."""

from dataclasses import replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.interfaces import Editor
from edit3r.pipeline import composite
from edit3r.reporting import warn
from edit3r.stage_checks import blaming, check_edit, component_name
from edit3r.types import EditRequest, Views

__all__ = ["StartsFromPictures", "edited", "edited_from", "for_views"]


@runtime_checkable
class StartsFromPictures(Protocol):
    """An editor that can begin its edit of `views` from other pictures of the same views.

    A diffusion editor adds noise to `start` at `strength` of its way (1: nothing but noise is left) and removes it
    with `views` and the prompt as conditions (Instruct-NeRF2NeRF, section 4.2).
    """

    def edit_from(
        self, views: Views, start: Float[Tensor, "batch view 3 height width"], request: EditRequest, strength: float
    ) -> Views: ...


@torch.no_grad()
def edited(editor: Editor, views: Views, request: EditRequest) -> Views:
    """The edit, held to the editor's contract and confined to the request's masks."""
    with blaming(editor):
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
    """The edit of `views` begun from the pictures `start`; `strength` in [0, 1] says how little of them stays.

    An editor that cannot begin from pictures edits anew, and its result is mixed with them; the run says so.
    """
    if isinstance(editor, StartsFromPictures):
        with blaming(editor):
            answer = editor.edit_from(views, start, request, strength)
        return _confined(editor, views, answer, request)
    warn(
        f"editor {component_name(editor)!r} cannot start from a given picture, so each new edit is mixed with it: "
        "a stand-in for the partial denoising of the published method."
    )
    anew = edited(editor, views, request)
    mixed = torch.lerp(start.clamp(0, 1), anew.images, strength)
    return _confined(editor, views, replace(views, images=mixed), request)


def for_views(request: EditRequest, indices: list[int]) -> EditRequest:
    """The request with the masks of some views."""
    return replace(request, masks=None if request.masks is None else request.masks[:, indices])


def _confined(editor: Editor, views: Views, answer: Views, request: EditRequest) -> Views:
    check_edit(editor, views, answer)
    if request.masks is None:
        return replace(views, images=answer.images)
    return replace(views, images=composite(views.images, answer.images, request.masks))
