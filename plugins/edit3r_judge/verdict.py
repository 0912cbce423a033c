"""How good a run came out, judged without any truth: does the scene show its own input views?

A scene whose rendering of a photo differs much from that (edited) photo shows other viewpoints no
better, and one that is guessed half-way between them shows nothing there. Three signals, whose
limits for each label stand in `fitted.yaml`: the agreement of the worst photo [dB], what is guessed
half-way, and how many photos are left out [shares]. See docs/notes/verdict.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import interpolate

from edit3r.contract.types import Rendering, Views
from edit3r.contract.verdicts import LABELS, Label, Verdict
from edit3r_judge.signals import limits_of_scenes


@dataclass(frozen=True)
class Doubt:
    """What speaks against a scene though it may show its photos well."""

    clause: str  # what was found and what to do, instead of advice about the photos
    best: Label = "fair"  # that the scene can get


def judge(
    edited: Views,
    first: Rendering,
    rendered: Rendering,
    placed: Sequence[bool],
    measured: Float[Tensor, "batch view"] | None,
    doubt: Doubt | None = None,
    ignored: Bool[Tensor, "batch view height width"] | None = None,
    guessed: Float[Tensor, "batch view"] | None = None,
) -> Verdict:
    """Judge the rendering of the placed views against their edited images.

    `first` shows the scene before any refiner and decides, unless `rendered`, the final one, is
    worse: photometric steps make every scene show its own photos, whether other viewpoints gain or
    not. It is compared at its own size, that of the grid of Gaussians. `placed` has one entry for
    each photo used; `edited`, the renderings and `measured` (share of pixels with measured depth,
    None where nobody knows it) hold the placed ones only. Of several scenes the worst counts. A
    `doubt` is what else speaks against the scene. Pixels that are `ignored` show what the scene
    leaves out. `guessed` is the share of the picture half-way to the nearest view that nobody
    measured (None: not known).
    """
    before, psnr = (
        _psnr(rendering, edited, ignored) for rendering in (first, rendered)
    )
    coverage = rendered.alphas.mean((2, 3, 4)).amin(0).tolist()
    filled = [None] * len(psnr) if measured is None else (1 - measured.amin(0)).tolist()
    between = [None] * len(psnr) if guessed is None else guessed.amax(0).tolist()
    evidence = [min(pair) for pair in zip(before, psnr)]
    label, reason = _label(edited, evidence, psnr, between, placed, doubt)
    return Verdict(
        label,
        reason,
        *(
            _with_gaps(values, placed)
            for values in (psnr, before, placed, coverage, filled, between)
        ),
    )


def _psnr(
    rendered: Rendering,
    edited: Views,
    ignored: Bool[Tensor, "batch view height width"] | None,
) -> list[float]:
    """PSNR [dB] of each view; of several scenes the worst counts."""
    errors = [
        _squared_error(
            rendered.images[:, one],
            edited.select(one),
            None if ignored is None else ignored[:, one],
        )
        # View by view: of many large photos, squares in double precision fill the memory.
        for one in ([view] for view in range(edited.count))
    ]
    error = torch.cat(errors, 1).amax(0).clamp(min=1e-10)
    return (-10 * torch.log10(error)).tolist()


def _squared_error(
    rendered: Float[Tensor, "batch view 3 height width"],
    edited: Views,
    ignored: Bool[Tensor, "batch view height width"] | None,
) -> Float[Tensor, "batch view"]:
    """Mean over the pixels that count."""
    height, width = rendered.shape[-2:]
    difference = rendered.clamp(0, 1) - edited.at((height, width)).images
    squares = difference.double().square().mean(2)
    counts = torch.ones_like(squares)
    if ignored is not None:
        counts -= interpolate(ignored.to(counts), (height, width), mode="nearest-exact")
    return (squares * counts).mean((2, 3)) / counts.mean((2, 3)).clamp(min=1e-3)


def _label(
    edited: Views,
    evidence: list[float],
    psnr: list[float],
    between: list[float | None],
    placed: Sequence[bool],
    doubt: Doubt | None,
) -> tuple[Label, str]:
    """The best label whose conditions hold, and one sentence for it; `evidence` and `psnr` of the
    placed views [dB].
    """
    mean, worst = sum(evidence) / len(evidence), min(evidence)
    guessed = max((share for share in between if share is not None), default=0.0)
    left_out = sum(not there for there in placed)

    limits = limits_of_scenes()

    def agrees(label: Label) -> bool:
        return worst >= limits[label]["agreement"]

    def holds(label: Label) -> bool:
        seen = guessed <= limits[label]["guessed"]
        lost = left_out > limits[label]["left_out"] * len(placed)
        return agrees(label) and seen and not lost

    found = next((label for label in LABELS[:-1] if holds(label)), LABELS[-1])
    if doubt is not None:
        found = max(found, doubt.best, key=LABELS.index)
    names = edited.called
    blamed = names[evidence.index(worst)]
    shown = f"the scene shows its photos at {sum(psnr) / len(psnr):.1f} dB on average"
    if found != "good":
        shown += f", and they fit together at {mean:.1f} dB, the worst ({blamed}) at {worst:.1f} dB"
    if left_out:
        shown += f"; {left_out} of {len(placed)} photos could not be placed"
    if guessed > limits["good"]["guessed"]:
        least_known = names[between.index(guessed)]
        shown += (
            f"; {guessed:.0%} of the view from {least_known} to its nearest is guessed"
        )
        if agrees(LABELS[max(0, LABELS.index(found) - 1)]):
            blamed = least_known
    if doubt is not None and found != "good":
        return found, f"{shown}; {doubt.clause}."
    return found, shown + _way_out(found, blamed, names[0], evidence, left_out) + "."


def _way_out(
    label: Label, worst: str, first: str, evidence: list[float], left_out: int
) -> str:
    """What to do; the first photo is to blame where the others do not find to it."""
    if label == "good":
        return ""
    if left_out > len(evidence):
        return f"; the others are placed by what they share with {first}: begin with another photo"
    if len(evidence) > 2:
        return f"; leave {worst} out, or add photos between it and the others"
    return "; take photos nearer to each other, or add some in between"


def _with_gaps(values: Sequence, placed: Sequence[bool]) -> tuple:
    """One entry for each photo used: the placed ones' values, None for those left out (False in
    `placed` itself).
    """
    if len(values) == len(placed):
        return tuple(values)
    rest = iter(values)
    return tuple(next(rest) if there else None for there in placed)
