"""How often the verdict on the edit is right: outlined objects, edited well and badly on purpose.

    python benchmarks/edit_verdict.py DATA --keep FOLDER --json ROWS.jsonl [--only fox mug]
    edit3r judge --fit ROWS.jsonl [--write]

DATA is a folder of photo sets, as for `benchmarks/clicks.py`, with the photos of `judged.json`
(`python benchmarks/outlines.py DATA fetch`); objects are those of `clicks.json`, `outlines.json`
and `judged.json` that are outlined on two photos. An edit made well is as bad as it looks:
`judged.json` has what was seen of edits before any verdict, and that counts. Each is edited in whole runs of 256 pixels:
well, and badly in each of the ways of `FAULTS`, which are made on the edited photos, in the masks
or in what the scene shows. A fault that nobody sees is none: one is left out where less than a
tenth of what is selected looks other than in the good edit (6, CIE Lab).

An object takes a minute. With --keep its edits stay in FOLDER and are not made again; signals are
then measured anew in seconds. --sheet draws each kind of edit of the objects in --only.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from clicks import filled
from edit3r_judge.signals import measured
from PIL import Image

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.contract.interfaces import Editor, EditToJudge, Selection
from edit3r.contract.types import Gaussians
from edit3r.kit.compute.colour import rgb_to_lab
from edit3r.kit.geometry.cameras import project
from edit3r.kit.sheet import draw_sheet
from edit3r.running import usual_reader
from edit3r.running.editors import edit_to_judge, read
from edit3r.running.steps.judge import seen_half_way

JUDGED = Path(__file__).with_name("judged.json")
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
    "shine": "shines_through",
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
        records, tasks = made.records, made.parts.tasks
        edit = edit_to_judge(records.inputs, records.selection, records.edit, tasks, 2)
        seen = partial(seen_half_way, made.rasterizer, cameras=made.cameras)
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--keep", type=Path, required=True, help="folder for the edits")
    parser.add_argument("--json", type=Path, help="rows for `edit3r judge --fit`")
    parser.add_argument("--only", nargs="*", default=[], help="names of the objects")
    parser.add_argument("--sheet", type=Path, help="image of the edits")
    args = parser.parse_args()
    args.keep.mkdir(exist_ok=True)
    rows, shown, seen = [], {}, json.loads(JUDGED.read_text())["seen"]
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
    for file in ("clicks.json", "outlines.json", "judged.json"):
        listed = json.loads(Path(__file__).with_name(file).read_text())
        for name, one in listed.get("objects", listed).items():
            photos = one.get("photos", one)
            if len(photos) > 1:
                found[f"{file.split('.')[0]}/{name}"] = photos
    return found


if __name__ == "__main__":
    main()
