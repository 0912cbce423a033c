"""Edits that hide something for good (`HidesThings`): no file of the run shows what they hide.

All that follows the edit gets the photos with the hidden pixels in place of their own, so that
scene, sheets, pages and pictures "before" cannot show others. What was read of the photos before,
such as a segmenter's features, is not kept.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.errors import PromptError, SettingsError
from edit3r.contract.reporting import note, say, warn
from edit3r.contract.types import Views
from edit3r.kit.geometry.maps import dilate
from edit3r.running.components import Components
from edit3r.running.records import EditedPhotos, Inputs, SelectedRegions
from edit3r.running.run_folder import HIDDEN

# By eye: how far beyond its outline a thing is hidden, and what soft outlines leave of it.
RIM = 0.01  # [longer sides]
SOFT = 0.2  # of a mask in [0, 1], above which a pixel is the thing's

Maps = Float[Tensor, "*batch height width"]


def require_hidden_wholly(components: Components) -> None:
    """Raise, before any photo is read, for what would leave some of a hidden thing visible."""
    if components.job.scene is not None:
        raise PromptError(
            "a thing of a given scene cannot be hidden for good, since its shape stays and so do "
            "the colours behind its surface; remove it instead, or hide it in the photos."
        )
    config = components.config
    usual = {"strength": 1.0, "feather": 0.0, "edit_views": "all"}
    for name, value in usual.items():
        got = getattr(config, name)
        if got != value:
            raise SettingsError(
                f"--{name.replace('_', '-')} {got}: would leave some of what is to be hidden "
                "visible; leave it out."
            )


def covering(regions: Maps) -> Maps:
    """Regions with a hard outline that lies outside soft ones, and without small gaps: 0 or 1."""
    radius = max(2, round(RIM * max(regions.shape[-2:])))
    wide = dilate((regions > SOFT).to(regions), 2 * radius)
    return -dilate(-wide, radius)


def hide(
    inputs: Inputs,
    selection: SelectedRegions,
    edit: EditedPhotos,
    components: Components,
) -> Inputs:
    """The inputs that show what the edit hides as little as the edited photos do; an earlier
    run's scene, which shows it, is forgotten.
    """
    _tell(inputs, selection, components)
    inside = _where(selection, inputs.start, components).any(0)[:, :, None]

    def hidden(views: Views) -> Views:
        return replace(
            views, images=torch.where(inside, edit.views.images, views.images)
        )

    photos, start = hidden(inputs.photos), hidden(inputs.start)
    return replace(inputs, photos=photos, start=start, before=None)


def without_candidates(inputs: Inputs, selection: SelectedRegions) -> Inputs:
    """The inputs of a question, on whose sheet each candidate is a grey shape."""
    maps = torch.zeros_like(inputs.photos.images[0, :, 0])
    for selected in selection.selected:
        maps = torch.maximum(maps, selected.masks[:, 0])
        for one in selected.candidates:
            maps[one.view] = torch.maximum(maps[one.view], one.mask.to(maps))
    inside = covering(maps)[None, :, None] > 0
    grey = inputs.photos.images.masked_fill(inside, 0.5)
    return replace(inputs, photos=replace(inputs.photos, images=grey))


def _where(
    selection: SelectedRegions, views: Views, components: Components
) -> Bool[Tensor, "instruction batch view height width"]:
    """Where each instruction that hides does so."""
    if selection.regions is not None:
        return selection.regions[list(components.hiding)] > 0
    everywhere = torch.ones_like(views.images[:, :, 0])
    masks = everywhere if selection.masks is None else selection.masks
    return masks[None] > 0


def _tell(inputs: Inputs, selection: SelectedRegions, components: Components) -> None:
    """Warn of photos on which nothing is hidden, and say which files still show it."""
    seen = _where(selection, inputs.start, components).flatten(3).any(3).all((0, 1))
    for view, name in enumerate(inputs.photos.names):
        if not seen[view]:
            warn(
                f"photo {view + 1} ({name}): nothing was hidden here; look at it before you share."
            )
    verdict = selection.verdict
    if verdict is not None and verdict.label == "question":
        warn(
            "it is not sure that the right thing is hidden; look at every photo before you share."
        )
    note(HIDDEN, True)
    earlier = " and the run before" if components.edits_again else ""
    say(
        "edit.hidden",
        "no file of this run shows what is hidden, so it keeps no cache; the photos that you gave"
        f"{earlier} still show it",
    )
