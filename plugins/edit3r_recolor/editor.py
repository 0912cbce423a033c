"""Recolour an object or the whole image from plain words, the same in every view."""

from dataclasses import asdict, replace
from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import reporting
from edit3r.config import PartChoice, Settings
from edit3r.contract.interfaces import Editor, Segmenter
from edit3r.contract.types import EditRequest, Views
from edit3r.errors import PromptError
from edit3r.selection.select import Selection
from edit3r_recolor.prompt import Instruction, parse_prompt
from edit3r_recolor.recoloring import (
    RecolorParameters,
    RecolorRanges,
    blend_regions,
    sample_parameters,
)
from edit3r_recolor.regions import choose_region, only_near
from edit3r_recolor.steps import Sample, apply_step

Share, SomeShare = (
    Annotated[float, Field(ge=0, le=1)],
    Annotated[float, Field(gt=0, le=1)],
)


class RecolorEditor(Editor):
    """Colour edits without a model: reads the prompt, finds the region, blends softly (section
    3.2).
    """

    class Settings(Settings):
        point: tuple[Share, Share] | None = Field(
            None,
            description="a point [x, y] on the object in the first view, in picture widths and "
            "heights",
        )
        box: tuple[Share, Share, SomeShare, SomeShare] | None = Field(
            None,
            description="a box [x, y, width, height] around the object in the first view, "
            "normalised likewise",
        )
        strength: float = Field(
            1.0, ge=0, le=1, description="share of the new colour; 0 returns the photo"
        )
        ranges: RecolorRanges = Field(
            RecolorRanges(),
            description="how strongly a recolouring without a named colour is sampled",
        )
        segmenter: PartChoice = Field(
            PartChoice(name="auto"), description="finds and follows the object"
        )

    def __init__(self, settings: Settings, segmenter: Segmenter) -> None:
        self.settings = settings
        self.segmenter = segmenter

    def edit(self, views: Views, request: EditRequest) -> Views:
        instructions = parse_prompt(request.prompt)
        parameters = sample_parameters(
            torch.Generator().manual_seed(request.seed), self.settings.ranges
        )
        self._refuse_two_answers(instructions, request.masks is not None)
        _note_instructions(instructions, parameters)
        images = []
        for index, scene in enumerate(views.images):
            given = None if request.masks is None else request.masks[index]
            images.append(
                self._recolor_scene(
                    scene, given, instructions, parameters, request.guess
                )
            )
        return replace(views, images=torch.stack(images))

    def _refuse_two_answers(
        self, instructions: tuple[Instruction, ...], masked: bool
    ) -> None:
        """Raise PromptError where marks, masks or words for the segmenter say one place and the
        prompt others.
        """
        told = (
            masked or self.settings.point or self.settings.box or self.segmenter.prompt
        )
        if told and len({(one.scope, one.subject) for one in instructions}) > 1:
            raise PromptError(
                f"the prompt names several places ({'; '.join(map(str, instructions))}), and "
                "clicks, boxes, masks or "
                "segmenter.prompt say one; ask for one, then for the next with --from the first "
                "run's folder."
            )
        if masked and instructions[0].scope == "all but":
            raise PromptError(
                "clicks, a box or a mask say where the edit goes, and the prompt where it does "
                "not; mark what changes "
                "and say 'paint it ...', or mark what stays by --set editor.point=[X,Y] (picture "
                "widths and heights)."
            )

    def _recolor_scene(
        self,
        images: Float[Tensor, "view 3 height width"],
        given: Float[Tensor, "view height width"] | None,
        instructions: tuple[Instruction, ...],
        parameters: RecolorParameters,
        guess: bool,
    ) -> Float[Tensor, "view 3 height width"]:
        point, box = self.settings.point, self.settings.box
        marks = Selection(
            ((0, *point),) if point else (), boxes={0: box} if box else {}, guess=guess
        )
        regions = [
            choose_region(images, given, one, self.segmenter, marks)
            for one in instructions
        ]
        regions = [
            only_near(region, images, one.near)
            for region, one in zip(regions, instructions)
        ]
        reporting.note("editor.region", "; ".join(region.source for region in regions))
        shares = [
            [round(float(share), 4) for share in region.masks.mean((1, 2))]
            for region in regions
        ]
        reporting.note("editor.region_share", shares[0] if len(shares) == 1 else shares)
        for region, instruction in zip(regions, instructions):
            recolored = images
            for step in instruction.steps:
                recolored = apply_step(recolored, region.masks, step, parameters)
            # Given masks blend once more behind every editor, so that a soft edge must not count
            # here already.
            masks = region.masks
            if given is not None:
                masks = torch.where(given > 0, masks / given.clamp(min=1e-6), 0).to(
                    images
                )
            images = blend_regions(
                images, recolored[None], self.settings.strength * masks[None]
            )
        return images


def _note_instructions(
    instructions: tuple[Instruction, ...], parameters: RecolorParameters
) -> None:
    """Note for the run's manifest what the prompt was understood as, and by which of its words."""
    reporting.note(
        "editor.understood", [{"read": str(one), **asdict(one)} for one in instructions]
    )
    read = "; ".join(f"{one} (words: {', '.join(one.words)})" for one in instructions)
    reporting.say("edit.understood", read)
    if any(isinstance(step, Sample) for one in instructions for step in one.steps):
        reporting.note("editor.parameters", asdict(parameters))
