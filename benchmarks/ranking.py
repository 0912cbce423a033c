"""Fits the weights of `edit3r_select` and measures them on scenes left out.

    python benchmarks/outlines.py ELSEWHERE
    python benchmarks/ranking.py DATA ELSEWHERE --kept ROWS.pkl [--write] [--never-fitted]
        [--left-out FITS.json] [--cache FOLDER]

Objects are those of `clicks.json`, `outlines.json` and `elsewhere.json`; outlines of two photos
that geometry can place are carried from the first to the second. Clicks lie uniformly in
the object, at its rim too; innermost clicks, strokes and boxes are those of `clicks.py`. Weights
are fitted to what the other scenes show, those of a first click before SAM is asked again; an
object's figures are those of weights that never saw its scene. Scenes that are never fitted on
are left out of all but the last look, --never-fitted. --write puts weights fitted to all other
scenes into `fitted.yaml`; --left-out keeps those of each scene left out, with which `clicks.py`
measures the whole product.
"""

import argparse
import json
import pickle
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
import yaml
from clicks import (
    ANYWHERE,
    FOV,
    at_size,
    filled,
    geometry_of,
    iou,
    line_on,
    next_click,
    places_on,
    reduced,
    remembering,
    resized,
    scene_of,
    tensor_of,
)
from edit3r_select.answering import (
    UNMARKED,
    answers_of,
    asked_by,
    gathered,
    selected,
    spread,
    subject_of,
)
from edit3r_select.carrying import expected_on
from edit3r_select.cues import CUES, Asked, Pool, table
from edit3r_select.photos import OnPhoto, Photos
from edit3r_select.ranking import (
    CERTAINTY,
    FITTED,
    CueWeights,
    choose,
    confidence,
    lead,
)
from PIL import Image
from scipy.optimize import minimize

from edit3r import build
from edit3r.contract.interfaces import SURE
from edit3r.kit.geometry.cameras import intrinsics_from_fov

HERE = Path(__file__).parent
NAMES = tuple(CUES)
SOFTNESS = 0.15  # of the goal: softmax of IoU over the masks
PENALTY = 10.0  # of standardised weights
RIGHT = 0.7  # IoU from which the confidence calls a mask right
BINS, HIGH = 5, 0.8  # of confidences that are compared with what is right
STROKES = 3
PARTS = 0.2  # how much a part's click counts beside a thing's in the fit

FIRST = ("click", "stroke", "box")
CARRIED, UNKNOWN = "carried", "unmarked"
USED = {
    CARRIED: (
        "quality",
        "square_of_log_area",
        "stability",
        "largest_piece",
        "expected",
    ),
    UNKNOWN: ("quality", "square_of_log_area", "stability", "border", "expected"),
}
"""Cues of kinds that do without some."""
Fits = dict[tuple[str, str | None], CueWeights]
"""By kind of marks and the scene that was left out; None: none was."""
Answerer = Callable[..., tuple[np.ndarray, np.ndarray]]


@dataclass
class Row:
    """One question: what was seen of each mask, and how well it fits."""

    name: str
    kind: str  # of `Asked.kind`
    way: str  # anywhere, innermost 1 to 3, stroke, box
    cues: np.ndarray  # [n, cue]
    ious: np.ndarray  # [n]
    # IoU of the mask that was taken, where one answer led to the next, and of the one before
    got: tuple[float, float] | None = None


@dataclass
class Thing:
    """An outlined object on one photo."""

    name: str
    scene: str
    source: str  # file without its ending
    part: bool
    file: Path
    polygons: list
    never_fitted: bool
    # file and polygons of another photo of it
    beside: tuple[Path, list] | None = None
    rows: list[Row] = field(default_factory=list)


def main() -> None:
    args = parsed()
    things = [
        one
        for one in listed(args.data, args.elsewhere)
        if one.file.is_file() and (args.never_fitted or not one.never_fitted)
    ]
    bench = Bench(args.cache)
    kept = pickle.loads(args.kept.read_bytes()) if args.kept.exists() else {}
    for thing in things:
        if thing.name not in kept:
            kept[thing.name] = bench.first_rows(thing)
            print(thing.name, flush=True)
            args.kept.write_bytes(pickle.dumps(kept))
        thing.rows = list(kept[thing.name])
    fits = folds(things, (*FIRST, CARRIED, UNKNOWN))
    for thing in things:
        bench.taken(thing, fits["click", thing.scene])
    fits |= corrections(things, bench, fits, args.rounds)
    print(report([one for one in things if not one.never_fitted], fits))
    print(calibration([one for one in things if not one.never_fitted], fits))
    if args.never_fitted:
        print("never fitted on")
        print(report([one for one in things if one.never_fitted], fits))
        print(calibration([one for one in things if one.never_fitted], fits))
    if args.write:
        content = entries(fits, None)
        FITTED.write_text(HEAD + yaml.safe_dump(content, sort_keys=False))
    if args.left_out:
        scenes = sorted({one.scene for one in things})
        args.left_out.write_text(
            json.dumps({one: entries(fits, one) for one in scenes})
        )


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("elsewhere", type=Path, help="photos of elsewhere.json")
    parser.add_argument("--kept", type=Path, required=True, help="rows so far")
    parser.add_argument("--cache", type=Path, help="folder for what the encoder read")
    parser.add_argument("--rounds", type=int, default=2, help="of corrected clicks")
    parser.add_argument("--never-fitted", action="store_true", help="the last look")
    parser.add_argument("--left-out", type=Path, help="file for weights by scene")
    parser.add_argument("--write", action="store_true", help="write fitted.yaml")
    return parser.parse_args()


def listed(data: Path, elsewhere: Path) -> Iterator[Thing]:
    """All outlined objects, each on its first photo."""
    for source, folder in (
        ("clicks", data),
        ("outlines", data),
        ("elsewhere", elsewhere),
    ):
        content = json.loads((HERE / f"{source}.json").read_text())
        for name, entry in content.get("objects", content).items():
            photos = entry.get("photos", entry)
            own = "benchmarks/"
            places = [
                HERE.parent / file if file.startswith(own) else folder / file
                for file in photos
            ]
            (polygons, *more), (file, *others) = photos.values(), places
            yield Thing(
                name,
                scene_of(next(iter(photos))),
                source,
                bool(entry.get("part")),
                file,
                polygons,
                bool(entry.get("never_fitted")),
                beside=(others[0], more[0]) if others else None,
            )


class Bench:
    """Asks about objects."""

    def __init__(self, cache: Path | None) -> None:
        self.cache, self.sam = cache, build("segmenter", "sam-onnx")
        self.salience = build("segmenter", "grabcut")
        self.matcher, self.geometries = build("matcher", "classical"), {}
        self._held: tuple[Path, np.ndarray, Answerer] | None = None

    def looked(self, thing: Thing) -> tuple[Answerer, np.ndarray]:
        """What answers on the photo, and the outline."""
        image = np.asarray(Image.open(thing.file).convert("RGB"))
        if self._held is None or self._held[0] != thing.file:
            photo = reduced(image)
            self._held = thing.file, photo, answers_of(self.sam, tensor_of(photo))
        _, photo, answers = self._held
        truth = at_size(filled(thing.polygons, image.shape[:2]), photo.shape[:2])
        return answers, truth

    def first_rows(self, thing: Thing) -> list[Row]:
        """Questions that need no earlier answer."""
        answers, truth = self.looked(thing)
        asked = [*first_clicks(truth, thing)]
        asked += [("stroke", one) for one in strokes(truth)]
        asked += [("box", one) for one in boxes(truth)]
        with remembering(self.cache):
            rows = [self.row(thing, way, one, answers, truth) for way, one in asked]
            return [*rows, *self.unmarked(thing), *self.carried(thing)]

    def taken(self, thing: Thing, click: CueWeights) -> None:
        """Notes in the rows of first clicks what is taken, asked again."""
        answers, truth = self.looked(thing)
        rows = [one for one in thing.rows if one.kind == "click"]
        with remembering(self.cache):
            for row, (_, asked) in zip(rows, first_clicks(truth, thing), strict=True):
                best = selected(truth.shape, asked, answers, click).best
                sums = row.cues @ click.values
                row.got = iou(best.mask, truth), float(row.ious[sums.argmax()])

    def unmarked(self, thing: Thing) -> Iterator[Row]:
        """Which of all that a photo shows is named, where only its photo is known."""
        answers, truth = self.looked(thing)
        assert self._held is not None
        salient = subject_of(self.salience, tensor_of(self._held[1]))
        scale = UNMARKED / max(truth.shape)
        size = tuple(max(1, round(side * scale)) for side in truth.shape)
        pool = spread(answers, size, salient[0].soft_mask) if salient else None
        if pool is not None:
            yield row_of(thing, UNKNOWN, pool, at_size(truth, size))

    def carried(self, thing: Thing) -> Iterator[Row]:
        """The outline of the first photo on a second one that geometry can place."""
        if thing.beside is None or not thing.beside[0].is_file():
            return
        images, truths = [], []
        for file, polygons in ((thing.file, thing.polygons), thing.beside):
            image = np.asarray(Image.open(file).convert("RGB"))
            images.append(tensor_of(reduced(image)))
            size = tuple(images[0].shape[-2:])
            truths.append(at_size(filled(polygons, image.shape[:2]), size))
        frames = torch.stack([images[0], resized(images[1], size)])
        geometry = geometry_of(frames, self.matcher, self.geometries)
        if geometry is None:
            return
        lens = intrinsics_from_fov(FOV, size).expand(1, 2, 3, 3)
        lens = lens if geometry.intrinsics is None else geometry.intrinsics
        photos = Photos(frames, self.sam, geometry, lens)
        given = OnPhoto(torch.from_numpy(truths[0]).float(), "given")
        marks = expected_on(photos, {0: given}, 1)
        if marks is not None:
            asked, answers = asked_by(marks, size), answers_of(self.sam, frames[1])
            yield self.row(thing, CARRIED, asked, answers, truths[1])

    def row(self, thing, way, asked, answers, truth) -> Row:
        pool = gathered(truth.shape, asked, answers)
        return row_of(thing, way, pool, truth)

    def corrected(self, thing: Thing, click: CueWeights, more: CueWeights) -> list[Row]:
        """The second and third innermost click, each in the middle of what is wrong."""
        answers, truth = self.looked(thing)
        clicks: tuple = (innermost(truth),)
        best = selected(truth.shape, Asked(clicks), answers, click).best
        rows = []
        with remembering(self.cache):
            for number in (2, 3):
                kind, place = next_click(best.mask, truth)
                clicks = (*clicks, (place, kind == "positive"))
                asked = Asked(clicks, before=best.logits)
                pool = gathered(truth.shape, asked, answers)
                was = best
                best = choose(pool, more).best
                ious = np.array([iou(mask, truth) for mask in pool.masks])
                got = iou(best.mask, truth), iou(was.mask, truth)
                way = f"innermost {number}"
                rows.append(Row(thing.name, "more", way, table(pool, NAMES), ious, got))
        return rows


def row_of(thing: Thing, way: str, pool: Pool, truth: np.ndarray) -> Row:
    kind = pool.asked.kind
    ious = np.array([iou(mask, truth) for mask in pool.masks])
    cues = table(pool, NAMES) * np.isin(NAMES, USED.get(kind, NAMES))
    return Row(thing.name, kind, way, cues, ious)


def innermost(truth: np.ndarray) -> tuple:
    return next_click(np.zeros_like(truth), truth)[1], True


def first_clicks(truth: np.ndarray, thing: Thing) -> Iterator[tuple[str, Asked]]:
    yield from (("anywhere", one) for one in anywhere(truth, thing))
    yield "innermost 1", Asked(clicks=(innermost(truth),))


def anywhere(truth: np.ndarray, thing: Thing) -> list[Asked]:
    """One click each, uniformly random in the object, always the same."""
    seed = [7, *thing.name.encode(), *thing.file.name.encode()]
    places = places_on(truth, ANYWHERE, seed)
    return [Asked(clicks=((place, True),)) for place in places]


def strokes(truth: np.ndarray) -> list[Asked]:
    lines = [line_on(truth, np.random.default_rng([11, n])) for n in range(STROKES)]
    return [Asked(stroke=one) for one in lines]


def boxes(truth: np.ndarray) -> list[Asked]:
    """The box around the object, each side off by up to a twentieth of its length."""
    height, width = truth.shape
    rows, columns = np.nonzero(truth.any(1))[0], np.nonzero(truth.any(0))[0]
    low = np.array([columns[0] / width, rows[0] / height])
    high = np.array([(columns[-1] + 1) / width, (rows[-1] + 1) / height])
    off = np.random.default_rng(13).uniform(-0.05, 0.05, (2, 2)) * (high - low)
    low, high = np.clip(low + off[0], 0, 1), np.clip(high + off[1], 0, 1)
    return [Asked(box=(*map(float, low), *map(float, high - low)))]


@dataclass
class Fit:
    """Rows of one kind as arrays; pools are filled up to the largest."""

    cues: np.ndarray  # [row, n, cue]
    there: np.ndarray  # [row, n]
    ious: np.ndarray  # [row, n]
    share: np.ndarray  # [row]: scenes alike, parts less

    @classmethod
    def of(cls, rows: list[tuple[Thing, Row]]) -> "Fit":
        most = max(len(row.ious) for _, row in rows)
        cues = np.zeros((len(rows), most, len(NAMES)))
        there, ious = np.zeros((len(rows), most), bool), np.zeros((len(rows), most))
        count: dict[str, int] = defaultdict(int)
        for index, (thing, row) in enumerate(rows):
            n = len(row.ious)
            cues[index, :n], there[index, :n], ious[index, :n] = (
                row.cues,
                True,
                row.ious,
            )
            count[thing.scene] += 1
        share = np.array(
            [(PARTS if t.part else 1) / count[t.scene] ** 0.5 for t, _ in rows]
        )
        return cls(cues, there, ious, share / share.mean())

    def weights(self) -> CueWeights:
        """Softmax over the masks towards softmax(IoU / softness)."""
        spread = self.cues[self.there].std(0) + 1e-6
        scaled = self.cues / spread
        goal = np.where(self.there, np.exp(self.ious / SOFTNESS), 0)
        goal /= goal.sum(1, keepdims=True)

        def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
            sums = np.where(self.there, scaled @ values, -np.inf)
            chance = np.exp(sums - sums.max(1, keepdims=True))
            chance /= chance.sum(1, keepdims=True)
            each = self.share[:, None] * goal * np.log(chance + 1e-12)
            off = self.share[:, None] * (goal - chance)
            slope = -(scaled * off[..., None]).sum((0, 1))
            total = -each.sum() + PENALTY * (values**2).sum()
            return total / len(goal), (slope + 2 * PENALTY * values) / len(goal)

        found = minimize(loss, np.zeros(len(NAMES)), jac=True, method="L-BFGS-B").x
        return CueWeights(NAMES, found / spread)


def started(click: CueWeights) -> CueWeights:
    """Weights for more clicks before any were fitted: those of a click, and what is marked."""
    told = {"obeyed": 4.0, "kept": 2.0, "middle": 2.0}
    extra = np.array([told.get(name, 0.0) for name in NAMES])
    return replace(click, values=click.values + extra)


def fitted_without(things: list[Thing], kind: str, scene: str | None) -> CueWeights:
    """The weights that all other scenes give; scenes that are never fitted on give none."""
    rows = [
        (thing, row)
        for thing in things
        if thing.scene != scene and not thing.never_fitted
        for row in thing.rows
        if row.kind == kind
    ]
    fit = Fit.of(rows)
    weights = fit.weights()
    sums = np.where(fit.there, fit.cues @ weights.values, -np.inf)
    right = fit.ious[np.arange(len(sums)), sums.argmax(1)] >= RIGHT
    told = np.array([seen(*pair) for pair in zip(fit.cues, sums)])
    return replace(weights, certainty=logistic(told, right))


def seen(cues: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """`sum.evidence` of a row."""
    best, of = sums.argmax(), NAMES.index
    areas = np.exp(-np.sqrt(cues[:, of("square_of_log_area")]))
    told = cues[best, [of("quality"), of("stability")]]
    return np.array([lead(sums, areas), *told, 1.0])


def logistic(told: np.ndarray, right: np.ndarray) -> np.ndarray:
    """How `CERTAINTY` tells whether the first mask is right; parts count as much as things."""
    spread = np.array([*(told[:, :-1].std(0) + 1e-6), 1.0])
    scaled, sign = told / spread, np.where(right, 1, -1)

    def loss(values: np.ndarray) -> float:
        off = np.logaddexp(0, -(scaled @ values) * sign).sum()
        return float(off + 0.5 * (values[:-1] ** 2).sum())

    found = minimize(loss, np.zeros(len(spread)), method="L-BFGS-B").x
    return found / spread


def folds(things: list[Thing], kinds: Sequence[str]) -> Fits:
    """The weights of each kind for each scene left out, and for none."""
    scenes = [*sorted({one.scene for one in things}), None]
    return {
        (kind, scene): fitted_without(things, kind, scene)
        for kind in kinds
        for scene in scenes
    }


def corrections(things: list[Thing], bench: Bench, fits: Fits, rounds: int) -> Fits:
    """Weights for more clicks. What is shown to be corrected depends on them, so that they are
    fitted in rounds; things keep the rows of the last.
    """
    more = {
        ("more", scene): started(weights)
        for (kind, scene), weights in fits.items()
        if kind == "click"
    }
    for number in range(rounds):
        for thing in things:
            click, then = (fits["click", thing.scene], more["more", thing.scene])
            rows = bench.corrected(thing, click, then)
            thing.rows = [one for one in thing.rows if one.kind != "more"] + rows
        if number + 1 < rounds:
            more = folds(things, ("more",))
    return more


def report(things: list[Thing], fits: Fits) -> str:
    """Mean IoU, share below 0.5 and mean of each object's worst, by way and source."""
    found: dict[tuple, list] = defaultdict(list)
    for thing in things:
        each: dict[str, list] = defaultdict(list)
        for row in thing.rows:
            sums = row.cues @ fits[row.kind, thing.scene].values
            each[row.way].append(
                float(row.ious[sums.argmax()]) if row.got is None else row.got[0]
            )
            each[f"{row.way}, best mask"].append(float(row.ious.max()))
        groups = ("all", "parts" if thing.part else "things", thing.source)
        for group in groups:
            for way, values in each.items():
                found[way, group].append(values)
    told = []
    for (way, group), values in sorted(found.items()):
        flat = np.concatenate(values)
        worst = np.mean([min(one) for one in values])
        told.append(
            f"{way:24s} {group:10s} {len(values):4d} objects  mean {flat.mean():.3f}  "
            f"below 0.5 {np.mean(flat < 0.5):4.0%}  worst {worst:.3f}"
        )
    return "\n".join(told)


def calibration(things: list[Thing], fits: Fits) -> str:
    """How often masks are right that are called so with a confidence, by kind of marks."""
    found: dict[str, list] = defaultdict(list)
    for thing in things:
        for row in thing.rows:
            weights = fits[row.kind, thing.scene]
            sums = row.cues @ weights.values
            sure = confidence(seen(row.cues, sums), weights)
            right = row.ious[sums.argmax()] if row.got is None else row.got[0]
            right = right >= RIGHT
            for group in (row.kind, "all", "parts" if thing.part else "things"):
                found[group].append((sure, right))
    told = []
    for group, pairs in found.items():
        sure, right = np.array(pairs, dtype=float).T
        bins = np.minimum((sure * BINS).astype(int), BINS - 1)
        off = [
            abs((sure - right)[bins == number].sum()) / len(sure)
            for number in range(BINS)
        ]
        high = sure >= HIGH
        told.append(
            f"{group:8s} {len(sure):5d}  error of confidence {sum(off):.3f}  "
            f"at {HIGH:.0%} and more {high.mean():.0%}, right {right[high].mean():.1%}  "
            f"below {SURE:.0%} {(sure < SURE).mean():.0%}, right {right[sure < SURE].mean():.1%}"
        )
    return "\n".join(told)


def entries(fits: Fits, scene: str | None) -> dict[str, dict]:
    """The weights that were fitted without a scene, as `fitted.yaml` has them."""
    found = {kind: fits[kind, scene] for kind in (*FIRST, CARRIED, UNKNOWN, "more")}
    return {
        kind: {
            "weights": {
                n: float(f"{v:.4g}")
                for n, v in zip(one.cues, one.values)
                if abs(v) > 1e-6
            },
            "confidence": dict(zip(CERTAINTY, one.certainty.round(3).tolist())),
        }
        for kind, one in found.items()
    }


HEAD = """\
# What multiplies each cue of `cues.py`, by the kind of marks; and what tells, as
# the exponent of a logistic, whether the first mask is right. Fitted by
#     python benchmarks/ranking.py DATA ELSEWHERE --kept ROWS.pkl --write
"""


if __name__ == "__main__":
    main()
