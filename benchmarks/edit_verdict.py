"""How often the verdict on the edit is right: edits of which it is known whether they are good.

    python benchmarks/edit_verdict.py DATA [--only fox mug] [--json OUT.json] [--sheet OUT.png]
    python benchmarks/edit_verdict.py DATA --looked-at [--only bear1 fox4] [--json OUT.json]

DATA is a folder of photo sets, as for `benchmarks/clicks.py`. Objects whose outlines were drawn by
hand in two photos are edited well, and badly on purpose, in whole runs: half the object, a leak to
its surroundings, another place, another thing in the second photo, nothing changed, another colour
than was asked for, a removed object whose outline stays. One row an edit, then how many good ones
are doubted and how many bad ones are named.

With --looked-at: the edits of `edit_verdict.json`, which somebody asked for by clicks and words and
then looked at. Each has its sentence, what was selected in each photo, how likely a part of that
was meant instead, and whether it came out as it was asked for. `chose_limits` is false for photos
that no limit was chosen by.
"""

import argparse
import base64
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from clicks import contact_sheet, filled
from edit3r_judge.edit_measures import measure_edit, measure_edit_in_3d
from edit3r_judge.edit_verdict import judge_edit
from PIL import Image

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.contract.interfaces import Editor, Selected
from edit3r.contract.verdicts import EditVerdict
from edit3r.running.editors import edit_to_judge

SIZE = 256
COLOURS = {"red": (0.8, 0.1, 0.1), "blue": (0.1, 0.2, 0.8), "green": (0.1, 0.6, 0.2)}


@dataclass(frozen=True)
class Case:
    """One edit of an object in two photos."""

    kind: str
    is_good: bool
    prompt: str
    masks: tuple[np.ndarray, np.ndarray]  # bool, as the photos
    editor: str | Editor | None = None


class Faint(Editor):
    """Changes next to nothing."""

    def edit(self, views, request):
        return replace(views, images=(views.images + 3 / 255).clamp(0, 1))


class Other(Editor):
    """Paints yellow, whatever is asked for."""

    def edit(self, views, request):
        yellow = views.images.new_tensor((0.9, 0.8, 0.1))[:, None, None]
        grey = views.images.mean(2, keepdim=True)
        return replace(views, images=(0.3 + grey).clamp(0, 1) * yellow)


class Ghost(Editor):
    """Fills the inside of a mask, and leaves the object's rim."""

    def edit(self, views, request):
        images = []
        for image, mask in zip(views.images[0], request.masks[0]):
            pixels = (image.permute(1, 2, 0).numpy() * 255).astype(np.uint8)
            hole = (mask.numpy() > 0.5).astype(np.uint8)
            inner = cv2.erode(hole, np.ones((7, 7), np.uint8))
            done = cv2.inpaint(
                pixels, cv2.dilate(inner, np.ones((3, 3))), 5, cv2.INPAINT_TELEA
            )
            images.append(torch.from_numpy(done).permute(2, 0, 1).float() / 255)
        return replace(views, images=torch.stack(images)[None])


def cases(masks: tuple[np.ndarray, np.ndarray], seed: int) -> Iterator[Case]:
    """Good edits of an object, and bad ones."""
    rng = np.random.default_rng(seed)
    colour = list(COLOURS)[seed % 3]
    paint = f"paint it {colour}"
    yield Case("paint", True, paint, masks)
    yield Case("black and white", True, "make it black and white", masks)
    yield Case("brighter", True, "make it brighter", masks)
    yield Case("half", False, paint, tuple(map(half, masks)))
    yield Case("half of one", False, paint, (masks[0], half(masks[1])))
    yield Case("leak", False, paint, tuple(leaking(mask, rng) for mask in masks))
    yield Case("another place", False, paint, tuple(moved(mask) for mask in masks))
    yield Case("another thing in one", False, paint, (masks[0], moved(masks[1])))
    yield Case("nothing changed", False, paint, masks, Faint(None))
    yield Case("another colour", False, paint, masks, Other(None))
    yield Case("rim left", False, "remove it", masks, Ghost(None))


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
    """An object with a disc about a place of its outline, as large as itself."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3)))
    rows, columns = np.nonzero(mask & (inner == 0))
    place = int(rng.integers(len(rows)))
    radius = int(np.sqrt(mask.sum() / np.pi))
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--only", nargs="*", default=[], help="names of the objects")
    parser.add_argument(
        "--looked-at", action="store_true", help="the edits of edit_verdict.json"
    )
    parser.add_argument("--json", type=Path, help="all figures")
    parser.add_argument(
        "--sheet", type=Path, help="image of every edit of the first photo"
    )
    args = parser.parse_args()
    if args.looked_at:
        rows = looked_at(args.data, args.only)
        if args.json:
            args.json.write_text(json.dumps(rows, indent=1))
        return
    objects = json.loads(Path(__file__).with_name("clicks.json").read_text())
    rows, tiles = [], []
    for seed, (name, photos) in enumerate(objects.items()):
        if len(photos) < 2 or (args.only and name not in args.only):
            continue
        if any(not (args.data / file).is_file() for file in photos):
            print(f"{name}: left out, its photos are not there")
            continue
        rows += measured(name, photos, args.data, seed, tiles)
    said(rows)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))
    if args.sheet:
        contact_sheet(tiles).save(args.sheet)


def looked_at(data: Path, only: list[str]) -> list[dict]:
    """A row for each edit that somebody looked at, and how often the verdict says the same."""
    edits = json.loads(Path(__file__).with_name("edit_verdict.json").read_text())
    rows = []
    caches: dict[tuple[str, ...], edit3r.Cache] = {}  # a pair is matched once
    for edit in edits:
        if only and edit["set"] not in only:
            continue
        cache = caches.setdefault(tuple(edit["photos"]), edit3r.Cache())
        try:
            verdict = verdict_on(edit, data, cache)
        except Edit3rError as error:
            print(f"{edit['set']}, {edit['prompt']}: {str(error)[:90]}")
            continue
        right = (verdict.label == "good") == edit["good"]
        print(
            f"{edit['set']:8} {edit['prompt']:36} {'  ' if right else 'X '}{verdict}",
            flush=True,
        )
        rows.append(
            {
                **{key: edit[key] for key in ("set", "prompt", "good", "chose_limits")},
                "label": verdict.label,
                "reason": verdict.reason,
                **verdict.measures,
            }
        )
    for chose in (True, False):
        own = [row for row in rows if row["chose_limits"] == chose]
        called = [row for row in own if row["label"] == "good"]
        good = [row for row in own if row["good"]]
        print(
            f"{'limits chosen by' if chose else 'no limit chosen by'}: of {len(own)} edits "
            f"{len(called)} called good, {sum(row['good'] for row in called)} of them are; of "
            f"{len(good)} good ones {sum(row['label'] != 'good' for row in good)} doubted"
        )
    return rows


def verdict_on(edit: dict, data: Path, cache: edit3r.Cache) -> EditVerdict:
    """The verdict on an edit of what was selected then, as if it had been selected now."""
    files = [str(data / file) for file in edit["photos"]]
    with tempfile.TemporaryDirectory() as folder:
        masks = [Path(folder) / f"{Path(file).stem}.png" for file in files]
        for mask, coded in zip(masks, edit["masks"]):
            mask.write_bytes(base64.b64decode(coded))
        result = edit3r.run(
            files, edit["prompt"], masks=masks, size=SIZE, outputs=[], cache=cache
        )
    how = "marked" if edit["clicked"] else "words"
    selected = Selected(result.masks[0][:, None], (how, "geometry"))
    records = result.records
    selection = replace(records.selection, selected=(selected,))
    tasks, count = result.parts.tasks, records.inputs.start.count
    asked = edit_to_judge(records.inputs, selection, records.edit, tasks, count)
    asked = replace(asked, rendered=result.rendered, cameras=result.cameras)
    measures = measure_edit_in_3d(measure_edit(asked), asked)
    measures = replace(measures, part=edit["part"])
    return judge_edit(measures, edit["confidence"])


def measured(name, photos, data, seed, tiles):
    """A row for each edit of one object."""
    files = [data / file for file in photos]
    shapes = [np.asarray(Image.open(file)).shape[:2] for file in files]
    masks = tuple(
        filled(polygons, shape) for polygons, shape in zip(photos.values(), shapes)
    )
    rows = []
    for case in cases(masks, seed):
        given = {file.stem: mask for file, mask in zip(files, case.masks)}
        try:
            result = done(files, case, given)
        except Edit3rError as error:
            print(f"{name}, {case.kind}: {str(error)[:90]}")
            continue
        verdict = result.edit_verdict
        row = {"object": name, "kind": case.kind, "good": case.is_good}
        row |= {
            "label": verdict.label,
            "reason": verdict.reason,
            **verdict.measures,
        }
        row["scene"] = result.verdict.label
        rows.append(row)
        right = case.is_good == (verdict.label == "good")
        print(
            f"{name:14} {case.kind:22} {'  ' if right else 'X '}{verdict}", flush=True
        )
        shown = (result.edited.images[0, 0].permute(1, 2, 0).numpy() * 255).astype(
            np.uint8
        )
        empty = np.zeros(shown.shape[:2], bool)
        tiles.append((f"{name}, {case.kind}: {verdict.label}", shown, empty, empty, {}))
    return rows


def done(files, case, given):
    """The run of one case."""
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for stem, mask in given.items():
            paths.append(Path(folder) / f"{stem}.png")
            Image.fromarray((mask * 255).astype(np.uint8)).save(paths[-1])
        editor = {} if case.editor is None else {"editor": case.editor}
        return edit3r.run(
            [str(file) for file in files],
            case.prompt,
            masks=paths,
            size=SIZE,
            outputs=[],
            **editor,
        )


def said(rows) -> None:
    """Print how often the verdict is right, by kind."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        own = [row for row in rows if row["kind"] == kind]
        doubted = sum(row["label"] == "doubtful" for row in own)
        print(f"{kind:22} doubted {doubted} of {len(own)}")
    for good in (True, False):
        own = [row for row in rows if row["good"] == good]
        doubted = sum(row["label"] == "doubtful" for row in own)
        print(f"{'good' if good else 'bad'} edits: {doubted} of {len(own)} doubted")


if __name__ == "__main__":
    main()
