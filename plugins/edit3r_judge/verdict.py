"""How good a scene came out, judged without any truth, and which part is to blame.

Half-way between photos it shows what was guessed, or what looks like no photo, where it does not
hold: the sum of both shares in the worst view, and how many photos are left out, give the label. A
part that is broken (`blame.py`) makes it `poor`, and photos that do not look like themselves make
it `failed`. Limits stand in `limits.yaml`. See docs/notes/verdict.md.
"""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import SceneToJudge
from edit3r.contract.types import Rendering
from edit3r.contract.verdicts import LABELS, Label, Part, Verdict
from edit3r_judge.blame import Doubt, beside, broken_part
from edit3r_judge.signals import fitted_limits, unlike_between

AS_SHARP = (
    (30, "as they are"),
    (25, "nearly as they are"),
    (20, "softer than they are"),
)
"""Agreement of scene and photos [dB], and what one sees of it."""


def judge(
    scene: SceneToJudge,
    guessed: Float[Tensor, "batch view"] | None = None,
    doubt: Doubt | None = None,
) -> Verdict:
    """The verdict on a scene; of several ones (a batch) the worst counts.

    The scene before any refiner decides, unless the final one is worse: photometric steps make
    every scene show its own photos, whether other viewpoints gain or not. `guessed` is the share of
    the picture half-way from each placed photo to its nearest that nobody measured (None: not
    known).
    """
    before, psnr = (_psnr(scene, shown) for shown in (scene.first, scene.rendered))
    coverage = scene.rendered.alphas.mean((2, 3, 4)).amin(0).tolist()
    unknown: list[float | None] = [None] * len(psnr)
    measured = scene.measured
    filled = unknown if measured is None else (1 - measured.amin(0)).tolist()
    between = unknown if guessed is None else guessed.amax(0).tolist()
    unlike = unlike_between(scene)
    cheapest = beside(scene)
    worse = max(one - other for one, other in zip(before, psnr))
    doubt = broken_part(scene, cheapest, worse) or doubt
    label, reason, part = _label(scene, before, psnr, between, unlike, doubt)
    by_photo: dict[str, Sequence[float | None]] = {
        "input_psnr": psnr,
        "agreement": before,
        "coverage": coverage,
        "filled": filled,
        "guessed_between": between,
        "unlike_between": unlike,
        "beside_geometry": cheapest.geometry,
        "beside_flat": cheapest.flat,
        "beside_reference": cheapest.reference,
    }
    entries = {
        name: tuple(next(rest) if there else None for there in scene.placed)
        for name, rest in ((name, iter(all_)) for name, all_ in by_photo.items())
    }
    return Verdict(label, reason, placed=scene.placed, part=part, **entries)


def _psnr(scene: SceneToJudge, shown: Rendering) -> list[float]:
    """PSNR [dB] of each placed view at the size of its rendering."""
    height, width = shown.images.shape[-2:]
    size, found = (height, width), []
    # view by view: of many large photos, squares in double precision fill the memory
    for view in range(scene.edited.count):
        image = shown.images[:, view].clamp(0, 1)
        difference = image - scene.edited.select([view]).at(size).images[:, 0]
        squares = difference.double().square().mean(1)
        error = squares.mean((1, 2))
        found.append(float(-10 * error.amax().clamp(min=1e-10).log10()))
    return found


def _label(
    scene: SceneToJudge,
    before: list[float],
    psnr: list[float],
    between: list[float | None],
    unlike: list[float | None],
    doubt: Doubt | None,
) -> tuple[Label, str, Part | None]:
    """The best label whose conditions hold, one sentence for it, and the part to blame."""
    evidence = [min(pair) for pair in zip(before, psnr)]
    worst, names, count = min(evidence), scene.edited.called, len(scene.placed)
    half_way = [(one or 0.0) + (other or 0.0) for one, other in zip(between, unlike)]
    bad, left_out = max(half_way), scene.placed.count(False)
    limits = fitted_limits("scene")

    def holds(label: Label) -> bool:
        limit = limits[label]
        return bad <= limit["half_way"] and left_out <= limit["left_out"] * count

    alike = worst >= limits["agreement"]
    label = next(filter(holds, LABELS[:-1]), LABELS[-1]) if alike else LABELS[-1]
    if doubt is not None:
        label = max(label, doubt.best, key=LABELS.index)
    sharp = sum(psnr) / len(psnr)
    seen = next((text for least, text in AS_SHARP if sharp >= least), "only roughly")
    shown = f"the scene shows its photos {seen}"
    if label == "good":
        return label, f"{shown}.", None
    blamed = names[evidence.index(worst)]
    if not alike:
        shown += f", and {blamed} hardly at all"
    if left_out:
        shown += f"; {left_out} of {count} photos could not be placed"
    if bad > limits["good"]["half_way"] and (doubt is None or doubt.best != "poor"):
        view = half_way.index(bad)
        guessed, off = (one[view] or 0.0 for one in (between, unlike))
        shown += (
            f"; half-way between {names[view]} and the photo nearest to it, {guessed:.0%} of the "
            f"picture is guessed, since no photo shows it well enough, and {off:.0%} looks like no "
            "photo"
        )
        if alike:
            blamed = names[view]
    if doubt is not None:
        return label, f"{shown}; {doubt.clause}.", doubt.part
    return label, f"{shown}; {_way_out(blamed, names, left_out)}.", "photos"


def _way_out(blamed: str, names: Sequence[str], left_out: int) -> str:
    """What to do; the first photo is to blame where the others do not find to it."""
    if left_out > len(names):
        return (
            f"the others are placed by what they share with {names[0]}: begin with another "
            "photo"
        )
    if len(names) > 2:
        return f"leave {blamed} out, or add photos between it and the others"
    return "take photos nearer to each other, or add some in between"
