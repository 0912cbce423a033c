"""Are verdicts right: on scenes, on edits, and a scene's own on its pixels?

python benchmarks/verdict.py scenes|edits|uncertainty --help
"""

import argparse
import functools
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from clicks import filled
from edit3r_judge.signals import measured
from edit3r_uncertainty.api import render_uncertainty
from edit3r_uncertainty.run import read_run
from edit3r_uncertainty.signals import (
    CONSTANT,
    SIGNALS,
    WRONG,
    photos_of,
    probability,
    signals_of,
)
from harness import HELD_OUT, for_tuning, run_benchmark
from likeness import (
    Likeness,
    as_numpy,
    between,
    camera_beside,
    drawn,
    likeness,
    mean,
    unseen_camera,
)
from PIL import Image
from scipy.stats import spearmanr
from torch import Tensor

import edit3r
from edit3r import Cameras, build
from edit3r.contract.errors import Edit3rError
from edit3r.contract.interfaces import Editor, EditToJudge, Rasterizer, Selection
from edit3r.contract.types import Gaussians
from edit3r.kit.compute.colour import rgb_to_lab
from edit3r.kit.contact_sheet import draw_sheet
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.photos.posed_folder import read_posed_folder
from edit3r.kit.rendering import render_numbers
from edit3r.running import usual_reader
from edit3r.running.editors import edit_to_judge, read
from edit3r.running.steps.judge import seen_half_way

# ---- scenes ----

BROKEN, SHARP = 0.15, 0.1  # LPIPS of views that are broken, and of those that are good
# photos, distance
DISTANCES = (
    (2, 2),
    (2, 4),
    (2, 8),
    (3, 2),
    (3, 4),
    (4, 2),
    (4, 5),
    (6, 2),
    (6, 3),
    (6, 7),
)


def sets_of(count: int) -> list[list[int]]:
    """Indices of the photos of each set."""
    found = [
        [start + gap * k for k in range(photos)]
        for photos, gap in DISTANCES
        for start in (0, count // 2)
    ]
    return [chosen for chosen in found if chosen[-1] < count]


def measure(folder: Path, chosen: list[int], size: int, unseen: list[int]) -> dict:
    """Reconstruct one set; the verdict, and how alike the held-out views whose two neighbours were
    placed are: PSNR [dB], SSIM and LPIPS.
    """
    cameras = read_posed_folder(folder).cameras
    targets = between(np.stack([camera.c2w[:3, 3] for camera in cameras]), chosen)
    files = [
        folder / cameras[i].file
        for i in (*chosen, *(t for t in targets if t is not None), *unseen)
    ]
    views, count = edit3r.load_views(files, size=size), len(chosen)
    numbers = iter(range(count, views.count))
    asked = [
        (k, next(numbers)) for k, target in enumerate(targets) if target is not None
    ]
    row = {"scene": folder.name, "photos": chosen, "between": targets}
    try:
        result = edit3r.run(
            replace(views.select(range(count)), c2w=None), editor="none", size=size
        )
    except Edit3rError as error:
        return {**row, "label": "refused", "reason": str(error)[:200], "held_out": []}
    placed = [i for i, there in enumerate(result.verdict.placed) if there]
    asked = [(k, target) for k, target in asked if {k, k + 1} <= set(placed)]
    verdict = result.verdict
    for name in ("label", "input_psnr", "agreement", "placed"):
        row[name] = getattr(verdict, name)
    shares = zip(verdict.guessed_between, verdict.unlike_between)
    row["half_way"] = max((sum(pair) for pair in shares if None not in pair), default=2)
    alike = [
        _held_out(result, views, (k, k + 1), placed.index(k), target)
        for k, target in asked
    ]
    row["held_out"] = [one.psnr for one in alike]
    if alike:
        row["deserved"] = deserved(mean(alike))
    last = range(views.count - len(unseen), views.count)
    row["unseen"] = dict(
        zip(unseen, (_unseen(result, views, placed, target) for target in last))
    )
    row["cpu_s"] = sum(stage.cpu_seconds for stage in result.report.stages)
    return row


def _held_out(
    result: edit3r.RunResult,
    views: edit3r.Views,
    pair: tuple[int, int],
    first: int,
    target: int,
) -> Likeness:
    """How alike view `target` is; the `pair` of its neighbours are cameras `first` and `first` + 1
    of the result.
    """
    true, found = views.c2w[0].double(), result.cameras.c2w[0].double()
    length = float((found[first, :3, 3] - found[first + 1, :3, 3]).norm())
    unit = length / float((true[pair[0], :3, 3] - true[pair[1], :3, 3]).norm())
    nearer = min(
        (0, 1),
        key=lambda side: float((true[pair[side], :3, 3] - true[target, :3, 3]).norm()),
    )
    near = pair[nearer], first + nearer
    return likeness(
        drawn(result, camera_beside(result, views, near, target, unit)),
        as_numpy(views, target),
    )


def _unseen(
    result: edit3r.RunResult, views: edit3r.Views, placed: list[int], target: int
) -> float:
    """PSNR [dB] of view `target`, placed relative to the nearest of the `placed` views."""
    camera = unseen_camera(result, views, placed, target)
    return likeness(drawn(result, camera), as_numpy(views, target)).psnr


def deserved(alike: Likeness) -> str:
    """The label that views between deserve: LPIPS decides where PSNR or SSIM agrees.

    Chosen by looking at 48 of them: poses that are off by a pixel cost PSNR, and nobody sees it.
    """
    if alike.lpips > BROKEN and (alike.psnr < 18 or alike.ssim < 0.55):
        return "poor"
    return "good" if alike.lpips < SHARP and alike.psnr >= 20 else "fair"


def row_for_fitting(row: dict) -> dict:
    """A row for `fit_verdict.py`."""
    figures = {"half_way": row["half_way"]}
    return {"place": row["scene"], "label": row["deserved"], "figures": figures}


def table(rows: list[dict]) -> str:
    """Markdown: sets of each label, and the mean and least held-out PSNR of a set."""
    lines = [
        "| verdict | sets | held-out PSNR, mean [dB] | lowest set | sets under 18 dB |",
        "| --- | --: | --: | --: | --: |",
    ]
    for label in ("good", "fair", "poor", "failed", "refused"):
        own = [row for row in rows if row["label"] == label]
        means = [
            sum(row["held_out"]) / len(row["held_out"])
            for row in own
            if row["held_out"]
        ]
        low = sum(mean < 18 for mean in means)
        shown = (
            f"{sum(means) / len(means):.1f} | {min(means):.1f} | {low} of {len(means)}"
            if means
            else "– | – | –"
        )
        lines.append(f"| {label} | {len(own)} | {shown} |")
    return "\n".join(lines)


def scenes() -> None:
    """Is the verdict of a run right? Sets of real photos with known cameras: input views against
    views between them.

        python benchmarks/verdict.py scenes FOLDER... --size 256 --write SETS --rows ROWS.jsonl
        python benchmarks/fit_verdict.py ROWS.jsonl [--write]
        python benchmarks/verdict.py scenes FOLDER --photos 0,7,14,21,28,35 --unseen 31,32,33,34

    Each folder holds photos and a cameras.json. Sets of 2, 3, 4 and 6 photos, evenly spaced at
    several distances, are reconstructed without their poses. Views between two placed neighbours,
    which the run has not seen, are then rendered from their true poses (relative to the nearer
    neighbour, in the unit that the neighbours are apart) and compared with their photos. One JSON
    line a set, and a table: for each label, how many sets it was given and their held-out PSNR.
    """
    parser = argparse.ArgumentParser(
        description=scenes.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument(
        "--photos",
        action="append",
        help="a set, such as 0,2,4, instead of the sets above; repeatable",
    )
    parser.add_argument(
        "--unseen", default="", help="photos to render besides, such as 31,33"
    )
    parser.add_argument(
        "--rows", type=Path, help="write rows for `fit_verdict.py` into this file"
    )
    parser.add_argument(
        "--write",
        type=Path,
        help="append one JSON line a set to this file; sets in it are not repeated",
    )
    args = parser.parse_args()
    rows = (
        [json.loads(line) for line in args.write.read_text().splitlines()]
        if args.write and args.write.is_file()
        else []
    )
    done = {(row["scene"], tuple(row["photos"])) for row in rows}
    for folder in for_tuning(args.folders):
        asked = [
            [int(number) for number in text.split(",")] for text in args.photos or []
        ]
        unseen = [int(number) for number in args.unseen.split(",") if number]
        for chosen in asked or sets_of(len(read_posed_folder(folder).cameras)):
            if (folder.name, tuple(chosen)) not in done:
                rows.append(measure(folder, chosen, args.size, unseen))
                if args.write:
                    with args.write.open("a") as file:
                        file.write(json.dumps(rows[-1]) + "\n")
    if rows:
        print(table(rows))
    if args.rows:
        known = (row_for_fitting(row) for row in rows if "deserved" in row)
        args.rows.write_text("".join(json.dumps(row) + "\n" for row in known))
    for row in rows:
        if row.get("unseen"):
            shown = ", ".join(
                f"{photo} {value:.1f}" for photo, value in row["unseen"].items()
            )
            print(f"{row['scene']} {row['photos']}, {row['label']}: {shown} dB")


# ---- edits ----

SIZE = 256
COLOURS = ("red", "blue", "green")
SEEN, LEAST = 6.0, 0.1  # difference that one sees [CIE Lab], and of which share
FEW = 60  # pixels of a mask below which an object is left out
Images = torch.Tensor  # [1, view, 3, height, width]
Masks = list[np.ndarray]  # bool, one a photo


def half(mask: np.ndarray) -> np.ndarray:
    """The left half of an object, or its upper half where it is taller than wide."""
    rows, columns = np.nonzero(mask)
    kept = mask.copy()
    if np.ptp(columns) >= np.ptp(rows):
        kept[:, int(np.median(columns)) :] = False
    else:
        kept[int(np.median(rows)) :] = False
    return kept


def leaking(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An object with a disc about a place of its outline, nearly as large as itself."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3)))
    rows, columns = np.nonzero(mask & (inner == 0))
    place = int(rng.integers(len(rows)))
    radius = max(3, int(0.8 * np.sqrt(mask.sum() / np.pi)))
    disc = np.zeros(mask.shape, np.uint8)
    cv2.circle(disc, (int(columns[place]), int(rows[place])), radius, 1, -1)
    return mask | (disc > 0)


def moved(mask: np.ndarray) -> np.ndarray:
    """An object's outline beside the object, where there is more room."""
    rows, columns = np.nonzero(mask)
    width = int(np.ptp(columns) * 0.8)
    left, right = columns.min(), mask.shape[1] - columns.max()
    step = width if right > left else -width
    kept = np.zeros_like(mask)
    inside = (columns + step >= 0) & (columns + step < mask.shape[1])
    kept[rows[inside], columns[inside] + step] = True
    return kept


def within(mask: np.ndarray) -> np.ndarray:
    """An object without a rim of three pixels, or as much as leaves a third of it."""
    found = mask.astype(np.uint8)
    for side in (7, 5, 3):
        inner = cv2.erode(found, np.ones((side, side), np.uint8), borderValue=1)
        if inner.sum() >= 0.3 * found.sum():
            break
    return inner > 0


def kept_where(where: Callable[[np.ndarray], np.ndarray]) -> Callable:
    """Leaves the edit only in a part of each mask."""

    def spoil(before: Images, after: Images, masks: torch.Tensor) -> Images:
        kept = [torch.from_numpy(where(one.numpy() > 0.5)) for one in masks[0]]
        return torch.where(torch.stack(kept)[None, :, None], after, before)

    return spoil


class Spoilt(Editor):
    """The answer of another editor, spoilt; to `instructions` where they are given."""

    def __init__(self, inner: str, spoil=None, instructions=None) -> None:
        super().__init__(None)
        self.inner, self.spoil = edit3r.build("editor", inner), spoil
        self.instructions = instructions

    def edit(self, views, request):
        asked = request
        if self.instructions is not None:
            asked = replace(
                request,
                instructions=self.instructions,
                prompt=self.instructions[0].text,
            )
        made = self.inner.edit(views, asked).images
        if self.spoil is not None:
            made = self.spoil(views.images, made, request.masks)
        return replace(views, images=made)


class Ghost(Editor):
    """Fills the inside of a mask, and leaves the object's rim."""

    def edit(self, views, request):
        images = []
        for image, mask in zip(views.images[0], request.masks[0]):
            pixels = (image.permute(1, 2, 0).numpy() * 255).astype(np.uint8)
            hole = (mask.numpy() > 0.5).astype(np.uint8)
            inner = cv2.erode(hole, np.ones((7, 7), np.uint8))
            wide = cv2.dilate(inner, np.ones((3, 3)))
            done = cv2.inpaint(pixels, wide, 5, cv2.INPAINT_TELEA)
            images.append(torch.from_numpy(done).permute(2, 0, 1).float() / 255)
        return replace(views, images=torch.stack(images)[None])


@dataclass(frozen=True)
class Case:
    """One edit of an object: what is asked for, in which masks, by whom, and judged in which."""

    kind: str
    prompt: str
    masks: Masks
    editor: Editor | None = None
    judged: Masks | None = None


JUDGED = Path(__file__).with_name("judged.json")
FAULTS = {
    "half": "unchanged",
    "half bw": "unchanged",
    "nothing": "unchanged",
    "leak": "outside",
    "other place": "shared",
    "wrong colour": "as_asked",
    "faint": "as_asked",
    "rim": "rim",
    "ghost": "rim",
    "shine": "closed",
    "undone paint": "missed",
    "undone half paint": "missed",
    "undone bw": "missed",
    "undone half bw": "missed",
    "torn": "torn",
    "dissolved": "torn",
}
"""The signal that shall name each way of editing badly."""


def cases(masks: Masks, seed: int) -> Iterator[Case]:
    """Good edits of an object, and bad ones; what is undone in 3D is made of them later."""
    rng = np.random.default_rng(seed)
    paint, other = (f"paint it {COLOURS[(seed + one) % 3]}" for one in (0, 1))
    grey, remove = "make it black and white", "remove it"
    wrong = tuple(read(other, usual_reader()))

    def spoilt(spoil, inner="recolor"):
        return Spoilt(inner, spoil)

    yield Case("paint", paint, masks)
    yield Case("bw", grey, masks)
    yield Case("brighter", "make it brighter", masks)
    yield Case("darker", "make it darker", masks)
    yield Case("remove", remove, masks)
    yield Case("half", paint, masks, spoilt(kept_where(half)))
    yield Case("half bw", grey, masks, spoilt(kept_where(half)))
    yield Case("rim", paint, masks, spoilt(kept_where(within)))
    yield Case("faint", paint, masks, spoilt(lambda b, a, _: b + 0.25 * (a - b)))
    yield Case("nothing", paint, masks, spoilt(lambda b, a, _: (b + 0.01).clamp(0, 1)))
    yield Case("wrong colour", paint, masks, Spoilt("recolor", instructions=wrong))
    yield Case("leak", paint, [leaking(one, rng) for one in masks], judged=masks)
    yield Case("other place", paint, [masks[0], moved(masks[1])])
    yield Case("ghost", remove, masks, Ghost(None))
    shine = spoilt(lambda b, a, _: 0.5 * (a + b), "retouch")
    yield Case("shine", remove, masks, shine)


def masks_of(photos: dict, files: list[Path], size: tuple[int, int]) -> Masks:
    """The outlined object on the views, whose width and height are `size` [pixels]."""
    masks = []
    for file, polygons in zip(files, photos.values()):
        full = filled(polygons, np.asarray(Image.open(file)).shape[:2])
        small = cv2.resize(full.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        masks.append(small > 0.5)
    return masks


def edits_of(photos: dict, data: Path, seed: int) -> dict[str, EditToJudge]:
    """The edits of one object by kind; those that no run takes are left out."""
    files = [data / file for file in photos][:2]
    views = edit3r.load_views(files, size=SIZE)
    masks = masks_of(photos, files, views.image_size[::-1])
    if min(int(one.sum()) for one in masks) < FEW:
        return {}
    asked = {"size": SIZE, "outputs": [], "cache": edit3r.Cache()}
    none = edit3r.run(views, editor="none", **asked).rendered.images
    found = {}
    for case in cases(masks, seed):
        given = {
            view: torch.from_numpy(one).float() for view, one in enumerate(case.masks)
        }
        editor = {} if case.editor is None else {"editor": case.editor}
        try:
            selection = Selection(masks=given)
            made = edit3r.run(views, case.prompt, masks=selection, **editor, **asked)
        except Edit3rError as error:
            print(f"{case.kind}: {str(error)[:90]}")
            continue
        records, tasks = made.records, made.components.tasks
        edit = edit_to_judge(records.inputs, records.selection, records.edit, tasks, 2)
        seen = functools.partial(seen_half_way, made.rasterizer, cameras=made.cameras)
        edit = replace(
            edit,
            rendered=made.rendered,
            cameras=made.cameras,
            in_2d=None,
            half_way=seen(made.gaussians) if made.cameras.count > 1 else None,
        )
        if case.judged is not None:
            own = torch.from_numpy(np.stack(case.judged)).float()[None]
            edit = replace(edit, masks=own, regions=own[None])
        found[case.kind] = edit
        if case.kind == "paint" and edit.half_way is not None:
            for kind in ("torn", "dissolved"):
                broken = displaced(made, masks, kind, np.random.default_rng(seed))
                found[kind] = replace(edit, half_way=seen(broken))
    for kind in ("paint", "bw"):
        if kind in found:
            edit, shown = found[kind], found[kind].rendered
            parts = [torch.from_numpy(half(one.numpy() > 0.5)) for one in edit.masks[0]]
            some = torch.where(torch.stack(parts)[None, :, None], none, shown.images)
            for name, images in (("undone", none), ("undone half", some)):
                undone = replace(shown, images=images)
                found[f"{name} {kind}"] = replace(edit, rendered=undone)
    return found


def displaced(
    made: edit3r.RunResult, masks: Masks, kind: str, rng: np.random.Generator
) -> Gaussians:
    """The scene with what is selected moved along the rays of the photos that it comes from: half
    of it by a fifth of its size half-way between the photos, or each Gaussian by chance.
    """
    cameras, means = made.cameras, made.gaussians.means.clone()
    apart = float(torch.dist(*cameras.c2w[0, :2, :3, 3]))
    for view, mask in enumerate(masks):
        height, width = mask.shape
        places, away = project(means, cameras.intrinsics[:, view], cameras.c2w[:, view])
        column, row = (places[0] * torch.tensor([width, height])).long().T
        which = torch.from_numpy(half(mask) if kind == "torn" else mask)
        inside = ((places[0] > 0) & (places[0] < 1)).all(-1)
        inside &= made.gaussians.view_index == view
        moved = torch.zeros_like(inside)
        moved[inside] = which[row[inside], column[inside]]
        if not moved.any():
            continue
        depth = away[0, moved]
        rows, columns = np.nonzero(mask)
        size = max(np.ptp(rows) / height, np.ptp(columns) / width)
        focal = float(cameras.intrinsics[0, view, 0, 0])
        step = np.full(len(depth), 0.2)
        if kind == "dissolved":
            step = 0.12 * rng.standard_normal(len(depth))
        inverse = 1 / depth + torch.from_numpy(step).float() * size * 2 / focal / apart
        middle = float(depth.median())
        now = 1 / inverse.clamp(0.2 / middle, 5 / middle)
        centre = cameras.c2w[0, view, :3, 3]
        means[0, moved] = centre + (means[0, moved] - centre) * (now / depth)[:, None]
    return replace(made.gaussians, means=means)


def is_seen(kind: str, found: dict[str, EditToJudge]) -> bool:
    """Whether enough of what is selected looks other than in the good edit."""
    if kind not in FAULTS:
        return True
    edit = found[kind]
    like = "bw" if "bw" in kind else "remove" if kind in ("ghost", "shine") else "paint"
    if like not in found:
        return False
    good, inside = found[like], edit.masks[0] > 0.5
    pictures = (good.after, edit.after)
    if "undone" in kind:
        pictures = good.rendered, edit.rendered
    elif kind in ("torn", "dissolved"):
        pictures = good.half_way.rendered, edit.half_way.rendered
    old, new = (rgb_to_lab(one.images[0].clamp(0, 1)) for one in pictures)
    other = (new - old).norm(dim=1) > SEEN
    if kind in ("torn", "dissolved"):
        return float(other.sum() / inside[:1].sum().clamp(min=1)) >= LEAST
    where = ~inside if kind in ("leak", "other place") else inside
    return float((other & where).sum() / inside.sum().clamp(min=1)) >= LEAST


def edits() -> None:
    """How often the verdict on the edit is right: outlined objects, edited well and badly on
    purpose.

        python benchmarks/verdict.py edits DATA --keep FOLDER --json ROWS.jsonl [--only fox mug]
        python benchmarks/fit_verdict.py ROWS.jsonl [--write]

    DATA is a folder of photo sets, as for `clicks.py`, with the photos of `judged.json` in it
    (`outlines.py DATA`); objects are those of `clicks.json`, `outlines.json` and
    `judged.json` that are outlined on two photos. Each is edited in whole runs of 256 pixels:
    well, and badly in each of the ways of `FAULTS`, which are made on the edited photos, in the
    masks or in what the scene shows. A fault that nobody sees is none: one is left out where less
    than a tenth of what is selected looks other than in the good edit (6, CIE Lab). What was made
    well and looks bad is bad: `judged.json` has what was seen of edits, before their verdict.

    An object takes a minute. With --keep its edits stay in FOLDER and are not made again; signals
    are then measured anew in seconds. --sheet draws each kind of edit of the objects in --only.
    """
    parser = argparse.ArgumentParser(
        description=edits.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--keep", type=Path, required=True, help="folder for the edits")
    parser.add_argument("--json", type=Path, help="rows for `fit_verdict.py`")
    parser.add_argument("--only", nargs="*", default=[], help="names of the objects")
    parser.add_argument("--sheet", type=Path, help="image of the edits")
    args = parser.parse_args()
    args.keep.mkdir(exist_ok=True)
    looked = json.loads(JUDGED.read_text())
    rows, shown, seen = [], {}, looked["seen"] | looked["seen_after"]
    for seed, (name, photos) in enumerate(objects().items()):
        path = args.keep / f"{name.replace('/', '-').replace(' ', '_')}.pt"
        if args.only and name not in args.only:
            continue
        if not path.exists() and all((args.data / file).is_file() for file in photos):
            try:
                torch.save(edits_of(photos, args.data, seed), path)
            except Edit3rError as error:
                print(f"{name}: {str(error)[:90]}")
        if not path.exists():
            continue
        found = torch.load(path, weights_only=False)
        for kind, edit in found.items():
            if is_seen(kind, found):
                fault = FAULTS.get(kind) or seen.get(f"{name}, {kind}")
                row = {"object": name, "place": next(iter(photos)).split("/")[0]}
                row |= {"kind": kind, "fault": fault, "figures": measured(edit)}
                rows.append(row)
                picture = edit.rendered if "undone" in kind else edit.after
                shown[f"{name}, {kind}"] = picture.images[0].float()
        print(f"{name}: {len(found)} edits", flush=True)
    if args.json:
        args.json.write_text("".join(json.dumps(row) + "\n" for row in rows))
    if args.sheet:
        draw_sheet(shown).save(args.sheet)


def objects() -> dict[str, dict]:
    """Outlines by photo of the objects that are outlined on two."""
    found = {}
    for file in ("clicks.json", "outlines.json", JUDGED.name):
        listed = json.loads(JUDGED.with_name(file).read_text())
        for name, one in listed.get("objects", listed).items():
            photos = one.get("photos", one)
            if len(photos) > 1:
                found[f"{file.split('.')[0]}/{name}"] = photos
    return found


# ---- uncertainty ----

SETS = {
    "bear": ((0, 2), (10, 14), (20, 22), (30, 32, 34), (40, 42)),
    "fox": ((0, 4), (10, 14), (20, 22, 24), (25, 29, 33, 37), (2, 6), (40, 44)),
    "fern": ((0, 2), (5, 9), (10, 12, 14), (2, 6, 10, 14), (15, 18)),
    "dinosaur": ((14, 17),),
    "monstree": ((0, 2), (4, 6), (8, 10, 12), (14, 16), (0, 3)),
    "berlin": ((0, 2), (0, 1)),
}
"""Photos of each set; others of these scenes were refused by the run."""
FRESH = {"7scenes_rgbd": ((0, 1), (4, 6), (8, 10), (12, 14, 16), (18, 20))}
STEP = 7  # every so many pixels are compared
BINS = 10


@dataclass(frozen=True)
class Judged:
    """One set's scene with its signals, and the pixels of the photos that it was not given."""

    scene: str
    gaussians: Gaussians
    signals: Tensor  # [gaussian, signal]
    shown: Tensor  # [view, gaussian]
    cameras: Cameras  # of the photos not given
    error: Tensor  # [camera, pixel], mean of red, green and blue
    alpha: Tensor  # [camera, pixel]
    plain: dict[str, Tensor]  # plain guesses [camera, pixel], higher: less sure

    @functools.cached_property
    def pixels(self) -> Tensor:
        """The signals where the scene shows something, rendered `[camera * pixel, signal]`."""
        lowest = self.signals.amin(0)
        alpha = self.alpha.clamp(min=0.05)
        columns = [
            self.rendered(column - low) / alpha + low
            for column, low in zip(self.signals.T, lowest)
        ]
        return torch.stack(columns, -1).flatten(0, 1)

    def rendered(self, numbers: Tensor) -> Tensor:
        """Numbers >= 0 `[gaussian]` in the pixels `[camera, pixel]`."""
        maps = render_numbers(
            rasterizer(), self.gaussians, numbers[None], self.cameras
        ).images
        return sampled(maps[0, :, 0])


@functools.cache
def rasterizer() -> Rasterizer:
    return build("rasterizer", "auto")


def sampled(maps: Tensor) -> Tensor:
    return maps.flatten(1)[:, ::STEP]


def judged(folder: Path, chosen: Sequence[int], keep: Path) -> Judged | None:
    """A set's scene, reconstructed where `keep` does not hold it; None: refused."""
    posed = read_posed_folder(folder).cameras
    centres = np.stack([camera.c2w[:3, 3] for camera in posed])
    targets = list(
        dict.fromkeys(k for k in between(centres, list(chosen)) if k is not None)
    )
    free = [k for k in range(len(posed)) if k not in (*chosen, *targets)]
    if free:  # the nearest other photo, which may lie outside
        steps = np.linalg.norm(centres[free, None] - centres[list(chosen)], axis=-1)
        targets.append(free[int(steps.min(1).argmin())])
    files = [folder / posed[k].file for k in (*chosen, *targets)]
    views = edit3r.load_views(files)
    given = replace(views.select(range(len(chosen))), c2w=None)
    place = keep / "_".join(map(str, (folder.name, *chosen)))
    if not place.is_dir():
        try:
            result = edit3r.run(given, editor="none", outputs=("scene", "images"))
        except Edit3rError as error:
            print(f"{place.name}: refused, {error}")
            return None
        result.save(place)
    run = read_run(place)
    placed = [views.names.index(name) for name in run.names]
    cameras, shown = held_out(run.cameras, views, placed, len(chosen))
    images = views.images[0, len(chosen) :][shown]
    signals, contributions = signals_of(
        run.gaussians, run.cameras, run.edited, rasterizer()
    )
    rendering = rasterizer().render(run.gaussians, cameras)
    wrong = rendering.images[0].clamp(0, 1) - images
    alphas = rendering.alphas[0, :, 0]
    points = unproject(rendering.depths[:, :, 0], cameras.intrinsics, cameras.c2w)[0]
    one = Judged(
        scene=folder.name,
        gaussians=run.gaussians,
        signals=signals,
        shown=contributions,
        cameras=cameras,
        error=sampled(wrong.abs().mean(1)),
        alpha=sampled(alphas),
        plain={
            "not covered (1 - alpha)": sampled(1 - alphas),
            "angle to the nearest photo": sampled(angles(points, cameras, run.cameras)),
        },
    )
    lonely = (photos_of(contributions) <= 1).float()
    contrast = signals[:, 0] - signals[:, 0].min()
    for name, numbers in (
        ("shown by one photo only", lonely),
        ("contrast of the photos alone", contrast / contrast.max()),
    ):
        one.plain[name] = one.rendered(numbers) + 1 - one.alpha
    return one


def held_out(
    found: Cameras, views: edit3r.Views, placed: list[int], count: int
) -> tuple[Cameras, list[int]]:
    """Cameras of the photos from `count` on whose nearest photo was placed, and which they are."""
    true = views.c2w[0].double()
    own = found.c2w[0].double()
    known = torch.pdist(true[placed, :3, 3]).sum()
    unit = torch.pdist(own[:, :3, 3]).sum() / known
    poses, shown = [], []
    for target in range(count, views.count):
        steps = (true[:count, :3, 3] - true[target, :3, 3]).norm(dim=1)
        nearest = int(steps.argmin())
        if nearest in placed:
            step = torch.linalg.inv(true[nearest]) @ true[target]
            step[:3, 3] *= unit
            poses.append((own[placed.index(nearest)] @ step).float())
            shown.append(target - count)
    intrinsics = views.intrinsics[:, count:][:, shown]
    return Cameras(torch.stack(poses)[None], intrinsics, views.image_size), shown


def angles(points: Tensor, cameras: Cameras, photos: Cameras) -> Tensor:
    """Angle at each point `[camera, H, W, 3]` between its camera and the nearest photo."""

    def directions(centres: Tensor) -> Tensor:
        return F.normalize(points - centres, dim=-1)

    own = directions(cameras.c2w[0, :, None, None, :3, 3])
    cosines = [(own * directions(c2w[:3, 3])).sum(-1) for c2w in photos.c2w[0]]
    return torch.stack(cosines).amax(0).clamp(-1, 1).acos()


def for_fitting(sets: Sequence[Judged]) -> list[Judged]:
    """All but the scenes that are held out of every choice."""
    return [one for one in sets if one.scene not in HELD_OUT]


def fitted(sets: Sequence[Judged]) -> tuple[Tensor, float]:
    """Factors and constant that fit the pixels of `sets` best; each set counts the same."""
    signals = torch.cat([one.pixels for one in sets])
    alpha = torch.cat([one.alpha.flatten() for one in sets])
    error = [one.error.flatten() for one in sets]
    truth = (torch.cat(error) > WRONG).float()
    weight = torch.cat(
        [torch.full_like(own, 1 / len(own) / len(sets)) for own in error]
    )
    centre = signals.mean(0)
    spread = signals.std(0).clamp(min=1e-6)
    signals = (signals - centre) / spread
    theta = torch.zeros(signals.shape[1] + 1, requires_grad=True)
    optimiser = torch.optim.LBFGS([theta], max_iter=60)

    def loss() -> Tensor:
        optimiser.zero_grad()
        share = (signals @ theta[1:] + theta[0]).sigmoid()
        promise = (share * alpha + 1 - alpha).clamp(1e-5, 1 - 1e-5)
        value = F.binary_cross_entropy(promise, truth, weight, reduction="sum")
        value.backward()
        return value

    with torch.enable_grad():
        optimiser.step(loss)
    theta = theta.detach()
    factors = theta[1:] / spread
    return factors, float(theta[0] - factors @ centre)


def report(sets: Sequence[Judged], given: tuple[Tensor, float] | None) -> None:
    """Print a line a set, the means, and the bins."""
    guesses = ("uncertainty", *sets[0].plain)
    print(f"| set | {' | '.join(guesses)} |")
    print(f"| --- |{' --: |' * len(guesses)}")
    promises, truths, figures = [], [], []
    for one in sets:
        rest = [other for other in for_fitting(sets) if other.scene != one.scene]
        number = probability(one.signals, one.shown, *(given or fitted(rest)))
        scene = replace(one.gaussians, uncertainty=number)
        promise = sampled(render_uncertainty(rasterizer(), scene, one.cameras)[0])
        figures.append(
            [scores(guess, one.error) for guess in (promise, *one.plain.values())]
        )
        cells = [f"{rank:.2f}, {area:.2f}" for rank, area in figures[-1]]
        print(f"| {one.scene} | {' | '.join(cells)} |", flush=True)
        promises.append(promise.flatten())
        truths.append((one.error > WRONG).float().flatten())
    means = np.mean(figures, 0)
    cells = [f"{rank:.3f}, {area:.3f}" for rank, area in means]
    print(f"| mean of {len(sets)} | {' | '.join(cells)} |")
    promise, truth = torch.cat(promises), torch.cat(truths)
    print("\n| promised | came true |\n| --: | --: |")
    for own in promise.argsort().chunk(BINS):
        print(f"| {promise[own].mean():.3f} | {truth[own].mean():.3f} |")


def scores(guess: Tensor, error: Tensor) -> tuple[float, float]:
    """Rank correlation with the error, and the area of the sparsification curve; means of views."""
    ranks = [spearmanr(*pair)[0] for pair in zip(guess, error)]
    areas = [area(*pair) for pair in zip(guess, error)]
    return float(np.nan_to_num(ranks).mean()), float(np.mean(areas))


def area(guess: Tensor, error: Tensor) -> float:
    """0: the pixels leave in the order of their error; 1: in any order.

    Pixels with the same guess leave in the order of a seeded shuffle.
    """
    mixed = torch.randperm(len(error), generator=torch.Generator().manual_seed(0))
    guess = guess[mixed]
    error = error[mixed].double()

    def mean_kept(order: Tensor) -> Tensor:
        kept = torch.arange(1, len(order) + 1)
        return (error[order].cumsum(0) / kept).mean()

    oracle = mean_kept(error.argsort())
    own = mean_kept(guess.argsort(stable=True))
    return float((own - oracle) / (error.mean() - oracle))


def uncertainty() -> None:
    """Does a scene's uncertainty tell where it is wrong? Views that no run was given, beside plain
    guesses.

        python benchmarks/verdict.py uncertainty DATA --keep /tmp/runs
        python benchmarks/verdict.py uncertainty DATA --keep /tmp/runs --fit
        python benchmarks/verdict.py uncertainty DATA --keep /tmp/runs --fresh

    DATA is a folder of photo sets with known cameras. The default run makes a scene of each set
    from its photos alone, without an edit. Its uncertainty is rendered in the photos between and
    beside them, at their true cameras relative to the nearest photo. The formula is fitted to the
    other scenes each time (leave one scene out), never to those held out. For each set: rank
    correlation (Spearman) with the true error of a pixel, and the area under the sparsification
    curve (mean error of the surest pixels that are kept), 0: as good as the true error, 1: as good
    as chance. Then ten bins of pixels: the promise and what came true. `--fit` prints the constants
    of all scenes, for `edit3r_uncertainty/signals.py`; `--fresh` judges those constants on a scene
    that took no part in any choice; `--without` leaves a signal out. `--keep` keeps the runs.
    """
    parser = argparse.ArgumentParser(
        description=uncertainty.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--keep", type=Path, help="folder that keeps the runs")
    parser.add_argument("--fit", action="store_true", help="print the constants")
    parser.add_argument("--fresh", action="store_true", help="judge the constants")
    parser.add_argument("--without", choices=SIGNALS, help="leave a signal out")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, torch.no_grad():
        keep = args.keep or Path(folder)
        keep.mkdir(exist_ok=True)
        sets = [
            one
            for scene, photos in (FRESH if args.fresh else SETS).items()
            for chosen in photos
            if (one := judged(args.data / scene, chosen, keep)) is not None
        ]
    if args.without:
        for one in sets:
            one.signals[:, list(SIGNALS).index(args.without)] = 0
    if args.fit:
        factors, constant = fitted(for_fitting(sets))
        for name, factor in zip(SIGNALS, factors.tolist()):
            print(f'"{name}": {factor:.3f},')
        print(f"CONSTANT = {constant:.3f}")
        return
    given = torch.tensor(list(SIGNALS.values())), CONSTANT
    report(sets, given if args.fresh else None)


if __name__ == "__main__":
    run_benchmark(scenes, edits, uncertainty)
