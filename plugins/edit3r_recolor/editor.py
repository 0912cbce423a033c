"""Recolour things or the whole image, the same in every view."""

from dataclasses import asdict, replace

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract import reporting
from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import Change, Colour, Instruction
from edit3r.contract.interfaces import Editor, EditsRegions
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.compute.layers import one_thread
from edit3r_recolor.paint import paint
from edit3r_recolor.recoloring import (
    RecolorParameters,
    RecolorRanges,
    blend_regions,
    sample_parameters,
)
from edit3r_recolor.steps import apply_change

METALS = {
    "gold": (0.86, 0.62, 0.16),
    "silver": (0.70, 0.72, 0.75),
    "bronze": (0.67, 0.42, 0.22),
    "copper": (0.76, 0.45, 0.32),
    "chrome": (0.66, 0.70, 0.75),
    "steel": (0.60, 0.63, 0.67),
}
"""sRGB in [0, 1] of metals under plain light, between shade and highlight. No figure kept."""

WHOLE = ("sky",)
"""Things without parts that keep their own colour: haze and clouds belong to the sky."""

GRAINED = ("marble", "wood", "snow")
"""Materials that are more than a colour: another editor draws them."""


class RecolorEditor(Editor, EditsRegions):
    """Colour edits without a model, blended softly by each instruction's region (section 3.2)."""

    class Settings(edit3r.Settings):
        strength: float = Field(1.0, ge=0, le=1)
        """share of the new colour; 0 returns the photo"""
        tolerance: float = Field(18, gt=0, le=90)
        """how far hues of a thing's one paint are apart [degrees]"""
        ranges: RecolorRanges = RecolorRanges()
        """how strongly a recolouring without a named colour is sampled"""

    settings: Settings

    def understands(self, instruction: Instruction) -> bool:
        grained = any(change.material in GRAINED for change in instruction.changes)
        return instruction.action == "paint" and not grained

    @one_thread()  # powers differ in their last bits by where threads divide an image
    def edit(self, views: Views, request: EditRequest) -> Views:
        instructions = request.asked()
        for instruction in instructions:
            if not self.understands(instruction):
                raise PromptError(
                    f"editor 'recolor' changes colours only; it cannot do {instruction.text!r}."
                )
        generator = torch.Generator().manual_seed(request.seed)
        parameters = sample_parameters(generator, self.settings.ranges)
        changes = [change for one in instructions for change in one.changes]
        if any(change.kind == "random" for change in changes):
            reporting.note("editor.parameters", asdict(parameters))
        scenes = []
        for index, images in enumerate(views.images):
            for number, instruction in enumerate(instructions):
                region = torch.ones_like(images[:, 0])
                if request.regions is not None:
                    region = request.regions[number, index].to(images)
                images = self._changed(images, region, instruction, parameters)
            scenes.append(images)
        return replace(views, images=torch.stack(scenes))

    def _changed(
        self,
        images: Float[Tensor, "view 3 height width"],
        region: Float[Tensor, "view height width"],
        instruction: Instruction,
        parameters: RecolorParameters,
    ) -> Float[Tensor, "view 3 height width"]:
        settings = self.settings
        everywhere = instruction.target.scope in ("whole", "region")
        thing = instruction.target
        flood = everywhere or "whole" in thing.qualifiers or thing.name in WHOLE
        changed = images
        for change in instruction.changes:
            if change.kind == "paint":
                changed = paint(
                    changed,
                    region,
                    METALS.get(change.material, _colour_of(change).rgb),
                    tolerance=settings.tolerance,
                    # a material is all of a thing
                    flood=flood or bool(change.material),
                    metal=change.material in METALS or change.finish == "metallic",
                    matte=change.finish == "matte",
                    than_now=change.than_now,
                )
            else:
                changed = apply_change(changed, change, parameters)
        return blend_regions(images, changed[None], settings.strength * region[None])


def _colour_of(change: Change) -> Colour:
    """The colour of a paint. Raises PromptError for that of a thing which nobody looked for."""
    if change.colour is None:
        raise PromptError(
            f"the thing in {str(change)!r} was not looked for, so its colour is unknown; name the "
            "colour, such as beige or #8a7f70."
        )
    return change.colour
