"""What a person marks or names: how well it is found, how long that takes, and what words find.

python benchmarks/clicks.py marks|seconds|words|questions --help
"""

import argparse
import cProfile
import json
import pstats
import resource
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import torch
from edit3r_select.by_segmenter import select_masks
from edit3r_select.marks import marks_on
from edit3r_select.obeying import points_of, seen_elsewhere
from edit3r_select.photos import Photos
from edit3r_select.ranking import CueWeights
from harness import run_benchmark
from PIL import Image, ImageDraw

from edit3r import Views, build, default_registry, load_views, select
from edit3r.contract.errors import Edit3rError, InputError
from edit3r.contract.interfaces import SURE, Selection
from edit3r.kit.cache import Cache, using
from edit3r.kit.files.configs import parse_assignments
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.running import default_matcher, geometry_of as geometry_read, usual_reader
from edit3r.running.geometry import find_geometry

# ---- marks ----

CLICKS = 3
ANYWHERE = 6  # first clicks a photo
STROKES = 3
PHOTOS = (".jpg", ".jpeg", ".png")
PAIRED = ("-a", "-b")  # ends of the names of generated pairs
STEPS = (1, 2, 3)  # to the neighbours in the folder that are tried
GOOD = 0.8  # IoU that a person takes without a second click
WORSE = 0.02  # a loss of IoU that a person sees
LONGER = 512  # longer side of what is clicked on [pixels]; larger photos are reduced
# stated for photos whose field of view nobody knows [radians]; the matcher reads its own
FOV = 1.05

Row = dict[str, Any]

SAID = {
    "opera house": "building",
    "plastic box": "box",
    "large mug": "mug",
    "wooden frame": "picture frame",
    "round mirror": "mirror",
}
"""The word that a person would say for an object, where it is not the object's name."""


def marks() -> None:
    """How well a click finds the thing: objects of real photos whose outlines were drawn by hand
    (`clicks.json`).

        python benchmarks/clicks.py marks DATA [--segmenter grabcut] [--set size=256]
    [--only bear mug] [--objects outlines.json] [--kept rows.jsonl] [--cache FOLDER]
    [--sheet OUT.png] [--strokes]

    DATA is a folder of photo sets; an object whose photos are not there is left out with a
    sentence. The first click is the object's innermost point, each further one the innermost point
    of the largest wrong region, positive or negative: the usual protocol of interactive
    segmentation. The mask after the last click is carried to the second photo twice, by the
    pictures and by the geometry that a matcher reads from the pair.

    People do not click on the innermost point. So six more first clicks lie uniformly random on the
    object, at its rim too, and with --named the same six come with the object's name beside them.
    Three strokes lie on it too. The clicked photo has the depth that it gets beside one or two
    photos of its folder, where these can be placed. All clicks together are given to the pair as
    well: each must be obeyed on both photos.

    The whole takes long. With --kept each object's row goes to a file as soon as it is measured,
    and what stands there is not measured again: a command that was stopped goes on. With --cache
    depth and what the encoder read are kept, so that a second measurement is quicker. --strokes
    measures strokes alone, in a fifth of the time. With --left-out each object is measured by
    weights that saw nothing of its scene (`ranking.py --left-out`).
    """
    args = parsed()
    segmenter = build("segmenter", args.segmenter, **parse_assignments(args.set))
    matcher = build("matcher", args.matcher) if args.matcher else None
    bench = Bench(args.data, segmenter, matcher, args.named, args.strokes)
    rows = kept_rows(args.kept)
    content = json.loads(args.objects.read_text())
    left_out = json.loads(args.left_out.read_text()) if args.left_out else {}
    for name, entry in content.get("objects", content).items():
        is_left_out = args.held_out and not entry.get("held_out")
        is_left_out |= args.never_fitted != bool(entry.get("never_fitted"))
        if is_left_out or (args.only and name not in args.only):
            continue
        if name not in rows:
            scene = scene_of(next(iter(entry.get("photos", entry))))
            with remembering(args.cache), weighed_by(left_out.get(scene)):
                row = bench.row(name, entry)
            if row is None:
                continue
            rows[name] = row
            keep_row(args.kept, name, row)
        print(line(name, [rows[name]]), flush=True)
    for held_out, title in ((False, "tuned on"), (True, "held out")):
        group = [row for row in rows.values() if row["held_out"] == held_out]
        if group:
            print(line(title, group))
            print(summary(group))
    if args.sheet and bench.tiles:
        contact_sheet(bench.tiles).save(args.sheet)


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=marks.__doc__.splitlines()[0])
    parser.add_argument(
        "data",
        type=Path,
        help="folder of photo sets, such as bear/images/frame_00001.jpg",
    )
    parser.add_argument("--segmenter", default="grabcut")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        help="a setting of the segmenter, such as size=256",
    )
    parser.add_argument(
        "--matcher",
        default="classical",
        help="reads the pair's geometry; '' leaves it out",
    )
    parser.add_argument(
        "--only", nargs="*", default=[], help="names of the objects to try"
    )
    parser.add_argument(
        "--objects",
        type=Path,
        default=Path(__file__).with_suffix(".json"),
        help="outlines by object and photo; as a value also {word, photos, held_out}, or under "
        "`objects`, as in elsewhere.json",
    )
    parser.add_argument(
        "--held-out", action="store_true", help="only what nothing was tuned on"
    )
    parser.add_argument(
        "--never-fitted", action="store_true", help="the last look: only these scenes"
    )
    parser.add_argument("--named", action="store_true", help="with names, too")
    parser.add_argument("--strokes", action="store_true", help="strokes alone")
    parser.add_argument("--kept", type=Path, help="rows measured so far, to go on with")
    parser.add_argument("--left-out", type=Path, help="weights by scene")
    parser.add_argument("--cache", type=Path, help="folder for depth and what is read")
    parser.add_argument(
        "--sheet", type=Path, help="picture of every mask, true outline in white"
    )
    return parser.parse_args()


def kept_rows(file: Path | None) -> dict[str, Row]:
    """Rows by object that an earlier command measured."""
    lines = file.read_text().splitlines() if file and file.is_file() else []
    return {one.pop("object"): one for one in map(json.loads, lines)}


def keep_row(file: Path | None, name: str, row: Row) -> None:
    if file is not None:
        with file.open("a") as out:
            out.write(json.dumps({"object": name, **row}) + "\n")


@contextmanager
def remembering(folder: Path | None) -> Iterator[None]:
    """What is read of photos is found in a folder, and kept there at the end."""
    cache = None if folder is None else Cache(folder)
    with using(cache):
        yield
    if cache is not None:
        cache.save(folder)


@contextmanager
def weighed_by(weights: dict | None) -> Iterator[None]:
    """The sum has other weights than those of `fitted.yaml`, where any are given."""
    if weights is None:
        yield
        return
    with patch(
        "edit3r_select.answering.fitted", lambda kind: CueWeights.of(weights[kind])
    ):
        yield


def scene_of(file: str) -> str:
    """Generated scenes are one place, and photos of one place in other sizes are that place."""
    first = file.split("/")[0]
    if first == "large":
        return "berlin" if file.split("/")[1][0].isdigit() else "monstree"
    return {"benchmarks": "generated"}.get(first, first)


class Bench:
    """All that is tried on an object."""

    def __init__(
        self, data: Path, segmenter, matcher, named: bool, strokes: bool
    ) -> None:
        self.data, self.segmenter, self.matcher = data, segmenter, matcher
        self.named, self.strokes = named, strokes
        self.tiles: list = []
        self.geometries: dict = {}

    def row(self, name: str, entry: dict) -> Row | None:
        """Figures of one object; None, and said so, where its photos are not there."""
        word, photos = SAID.get(name, name), entry
        if "photos" in entry:
            word, photos = entry["word"].split(",")[0], entry["photos"]
        files = [self.place_of(file) for file in photos]
        missing = [file for file in files if not file.is_file()]
        if missing:
            print(f"{name}: left out, {missing[0]} is not there")
            return None
        images, truths = [], []
        for file, polygons in zip(files, photos.values()):
            image = np.asarray(Image.open(file).convert("RGB"))
            truth = filled(polygons, image.shape[:2])
            images.append(reduced(image))
            truths.append(at_size(truth, images[-1].shape[:2]))
        depth = depth_of(files[0], self.matcher, self.geometries)
        first = images[0], truths[0], self.segmenter
        row: Row = {}
        if not self.strokes:
            row = self.corrected(name, images, truths, depth)
            row["anywhere"], row["shares"] = anywhere(*first, "", depth)
        if self.named and not self.strokes:
            said = usual_reader().read_target(word).name
            row["named"], _ = anywhere(*first, said, depth)
        row["strokes"] = stroked(*first, depth)
        row["depth"] = depth[0] is not None
        row["held_out"] = bool(entry.get("held_out"))
        return row

    def place_of(self, file: str) -> Path:
        """Photos of generated scenes lie beside this script."""
        here = Path(__file__).parents[1] / file
        return here if file.startswith("benchmarks/") else self.data / file

    def corrected(self, name, images, truths, depth) -> Row:
        """IoU after each click, carried by pictures and by geometry, CPU seconds."""
        frame = tensor_of(images[0])
        clicks: dict[str, list] = {"positive": [], "negative": []}
        mask, scores, seconds = np.zeros_like(truths[0]), [], []
        for _ in range(CLICKS):
            kind, place = next_click(mask, truths[0])
            clicks[kind].append((0, *place))
            selection = selected_by(clicks)
            start = time.process_time()
            soft = select_masks(frame[None], selection, self.segmenter, *depth)
            soft = soft.masks[0, 0]
            seconds.append(time.process_time() - start)
            mask = soft.numpy() > 0.5
            scores.append(iou(mask, truths[0]))
            title = f"{name}, {len(scores)} clicks: {scores[-1]:.2f}"
            self.tiles.append((title, images[0], truths[0], mask, dict(clicks)))
        row: Row = {"clicks": scores, "seconds": float(np.mean(seconds))}
        if len(images) > 1:
            frames = [frame, resized(tensor_of(images[1]), frame.shape[-2:])]
            row |= self.carried(name, torch.stack(frames), truths, soft, clicks)
        return row

    def carried(self, name, frames, truths, soft, clicks) -> Row:
        """IoU on the second photo, by pictures and by geometry, and how many marks are obeyed.

        The mask of photo 1 is carried as it came out, so that this measures the carrying and what
        the clicks left wrong.
        """
        truth = at_size(truths[1], truths[0].shape)
        lens = intrinsics_from_fov(FOV, tuple(frames.shape[-2:])).expand(1, 2, 3, 3)
        geometry = geometry_of(frames, self.matcher, self.geometries)
        row: Row = {}
        for way, found in (("pictures", None), ("geometry", geometry)):
            if way == "geometry" and found is None:
                continue
            given = Selection(masks={0: soft})
            selected = select_masks(frames, given, self.segmenter, found, lens)
            there = selected.masks[1, 0].numpy() > 0.5
            row[way] = iou(there, truth)
            picture = (frames[1].permute(1, 2, 0).numpy() * 255).astype(np.uint8)
            title = f"{name}, carried ({selected.how[1]}): {row[way]:.2f}"
            self.tiles.append((title, picture, truth, there, {}))
        selection = selected_by(clicks)
        selected = select_masks(frames, selection, self.segmenter, geometry, lens)
        row["marks"] = obeyed_marks(selection, selected.masks, geometry, lens)
        return row


def selected_by(clicks: dict[str, list]) -> Selection:
    return Selection(**{kind: tuple(places) for kind, places in clicks.items()})


def obeyed_marks(selection, masks, geometry, lens) -> tuple[int, int]:
    """How many of the marks are obeyed, of all that their own and the second photo show."""
    own = points_of(marks_on(selection, 0))
    shown = [(0, point) for point in own]
    if geometry is not None:
        lens = lens if geometry.intrinsics is None else geometry.intrinsics
        photos = Photos(masks, None, geometry, lens)
        shown += [(1, one) for one in seen_elsewhere(own, photos, 0, 1)]
    height, width = masks.shape[-2:]
    obeyed = 0
    for view, point in shown:
        x, y = point.place
        inside = masks[view, 0, int(y * height), int(x * width)] > 0.5
        obeyed += bool(inside) == point.wanted
    return obeyed, len(shown)


def tensor_of(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image.copy()).permute(2, 0, 1).float() / 255


def reduced(image: np.ndarray) -> np.ndarray:
    """A photo whose longer side is at most `LONGER`, as the app selects on."""
    scale = LONGER / max(image.shape[:2])
    if scale >= 1:
        return image
    size = [round(length * scale) for length in image.shape[1::-1]]
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def at_size(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A bool mask at another size."""
    if mask.shape == tuple(shape):
        return mask
    return cv2.resize(mask.astype(np.float32), shape[::-1]) > 0.5


def filled(polygons: list, shape: tuple[int, int]) -> np.ndarray:
    """Bool mask `[H, W]` inside an odd number of polygons."""
    inside = np.zeros(shape, dtype=bool)
    for polygon in polygons:
        canvas = Image.new("1", shape[::-1])
        ImageDraw.Draw(canvas).polygon([tuple(place) for place in polygon], fill=1)
        inside ^= np.asarray(canvas)
    return inside


def depth_of(photo, matcher, known):
    """Geometry of a photo alone and its intrinsics, read beside its neighbours in the folder; two
    Nones where they cannot be placed.
    """
    if photo in known:
        return known[photo]
    known[photo] = (None, None)
    files = sorted(
        one for one in photo.parent.iterdir() if one.suffix.lower() in PHOTOS
    )
    if photo.stem.endswith(PAIRED):  # of a generated pair, whose neighbour is another
        files = [one for one in files if one.stem[:-1] == photo.stem[:-1]]
    place = files.index(photo)
    for step in STEPS if matcher is not None else ():
        chosen = [place, place - step, place + step, place + 2 * step]
        chosen = [index for index in chosen if 0 <= index < len(files)][:3]
        if len(chosen) < 2:
            continue
        images = [as_tensor(files[index]) for index in chosen]
        frames = torch.stack([resized(one, images[0].shape[-2:]) for one in images])
        lens = intrinsics_from_fov(FOV, tuple(frames.shape[-2:]))
        lens = lens.expand(1, len(frames), 3, 3)
        views = Views(frames[None], lens, assumed=(True,) * len(frames))
        found = find_geometry(matcher, views)
        if (
            found.geometry is None
            or found.problem
            or not found.geometry.registered[0, 0]
        ):
            continue
        geometry, lens = found.geometry, found.geometry.calibrated(views).intrinsics
        alone = replace(
            geometry,
            c2w=geometry.c2w[:, :1],
            depths=geometry.depths[:, :1],
            confidence=geometry.confidence[:, :1],
            registered=geometry.registered[:, :1],
            intrinsics=None,
        )
        known[photo] = (alone, lens[:, :1])
        break
    return known[photo]


def as_tensor(file):
    return tensor_of(reduced(np.asarray(Image.open(file).convert("RGB"))))


def stroked(image, truth, segmenter, depth):
    """IoU of some strokes on the object: straight lines, as long as most that fit there."""
    tensor = tensor_of(image)[None]
    found = []
    for seed in range(STROKES):
        stroke = ((0, line_on(truth, np.random.default_rng([11, seed]))),)
        soft = select_masks(tensor, Selection(strokes=stroke), segmenter, *depth).masks
        found.append(iou(soft[0, 0].numpy() > 0.5, truth))
    return found


def line_on(truth, random):
    """Places (x, y in [0, 1]) along a line that lies wholly inside a bool mask."""
    depth = cv2.distanceTransform(truth.astype(np.uint8), cv2.DIST_L2, 5)
    rows = np.argwhere(depth > 0.15 * depth.max())
    start = rows[random.integers(len(rows))]
    lines = []
    for angle in random.uniform(0, 2 * np.pi, 60):
        way, length = np.array([np.sin(angle), np.cos(angle)]), 0
        while True:
            row, column = np.round(start + way * (length + 2)).astype(int)
            within = 0 <= row < truth.shape[0] and 0 <= column < truth.shape[1]
            if not within or depth[row, column] < 0.1 * depth.max():
                break
            length += 2
        lines.append((length, tuple(way)))
    length, way = sorted(lines)[int(0.75 * len(lines))]
    places = [start + np.array(way) * length * share for share in np.linspace(0, 1, 6)]
    height, width = truth.shape
    return tuple(((x + 0.5) / width, (y + 0.5) / height) for y, x in places)


def anywhere(image, truth, segmenter, words, depth):
    """IoU after each of some first clicks anywhere on the object, always at the same places, and
    the share of all scores that the candidate taken has.
    """
    tensor = tensor_of(image)[None]
    found, shares = [], []
    for place in places_on(truth, ANYWHERE):
        selection = Selection(positive=((0, *place),), words=words)
        selected = select_masks(tensor, selection, segmenter, *depth)
        found.append(iou(selected.masks[0, 0].numpy() > 0.5, truth))
        shares.append(selected.candidates[0].score if selected.candidates else 0.0)
    return found, shares


def places_on(
    truth: np.ndarray, count: int, seed: Sequence[int] = (7,)
) -> list[tuple[float, float]]:
    """Places (x, y in [0, 1]) uniformly random in a bool mask, at its rim too; always the same."""
    rows = np.argwhere(truth)
    random = np.random.default_rng(seed)
    chosen = random.choice(len(rows), min(count, len(rows)), replace=False)
    height, width = truth.shape
    return [((x + 0.5) / width, (y + 0.5) / height) for y, x in rows[chosen]]


def geometry_of(frames, matcher, known):
    """What the matcher reads from a pair, once per pair; None where it cannot place the photos."""
    key = hash(tuple(float(frame.sum()) for frame in frames))
    if matcher is not None and key not in known:
        lens = intrinsics_from_fov(FOV, tuple(frames[0].shape[-2:])).expand(1, 2, 3, 3)
        try:
            known[key] = matcher.match(Views(frames[None], lens, assumed=(True, True)))
        except Edit3rError as error:
            print(f"  no geometry: {error}")
            known[key] = None
    return known.get(key)


def resized(image: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """An image `[3, H, W]` at another size."""
    if tuple(image.shape[-2:]) == tuple(size):
        return image
    return torch.nn.functional.interpolate(
        image[None], size, mode="bilinear", antialias=True
    )[0].clamp(0, 1)


def next_click(mask: np.ndarray, truth: np.ndarray) -> tuple[str, tuple[float, float]]:
    """Kind and place (x, y in [0, 1]) of the innermost point of the largest wrong region."""
    kinds = {"positive": truth & ~mask, "negative": mask & ~truth}
    best, kind, place = -1, "positive", (0.5, 0.5)
    for name, wrong in kinds.items():
        _, labels, stats, _ = cv2.connectedComponentsWithStats(
            wrong.astype(np.uint8), connectivity=4
        )
        if len(stats) < 2 or stats[1:, cv2.CC_STAT_AREA].max() <= best:
            continue
        largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
        best, kind = int(stats[largest, cv2.CC_STAT_AREA]), name
        depth = cv2.distanceTransform(
            np.pad((labels == largest).astype(np.uint8), 1), cv2.DIST_L2, 5
        )[1:-1, 1:-1]
        row, column = np.unravel_index(depth.argmax(), depth.shape)
        place = ((column + 0.5) / truth.shape[1], (row + 0.5) / truth.shape[0])
    return kind, place


def iou(one: np.ndarray, other: np.ndarray) -> float:
    return float((one & other).sum() / max(1, (one | other).sum()))


def line(name: str, rows: list[Row]) -> str:
    """One line of the table, of one row or the mean of many, leaving gaps out."""
    clicked = [row["clicks"] for row in rows if "clicks" in row]
    values = {
        "1 click" if not n else str(n + 1): [scores[n] for scores in clicked]
        for n in range(CLICKS)
    }
    for key in ("anywhere", "named", "strokes", "pictures", "geometry", "seconds"):
        values[key] = [np.mean(row[key]) for row in rows if key in row]
    cells = [f"{key} {np.mean(some):.2f}" for key, some in values.items() if some]
    return f"{name:16s}  " + "  ".join(cells)


def summary(rows: list[Row]) -> str:
    """Shares of good and of poor masks, how often a correcting click made one worse, and how many
    marks are obeyed.
    """
    scores = np.array([row.get("clicks", ()) for row in rows], dtype=float)
    worse = (np.diff(scores, axis=1) < -WORSE).sum()
    marks = np.sum([row.get("marks", (0, 0)) for row in rows], axis=0)
    told = [f"{len(rows)} objects, {sum(row['depth'] for row in rows)} with depth"]
    measured = {
        key: [row.get(key, ()) for row in rows] for key in ("anywhere", "strokes")
    }
    for title, some in {"innermost": scores[:, :1], **measured}.items():
        each = np.ravel(some)
        if each.size:
            good, poor = np.mean(each >= GOOD), np.mean(each < 0.5)
            told.append(f"{title}: {good:.0%} at {GOOD} or more, {poor:.0%} below 0.5")
    if not scores.size:
        return "\n".join(f"  {one}" for one in told)
    told.append(f"made worse by {worse} of {scores[:, 1:].size} correcting clicks")
    told.append(
        f"marks obeyed on the photos of pairs that show them: {marks[0]} of {marks[1]}"
    )
    return "\n".join(f"  {one}" for one in told)


def contact_sheet(tiles: list, width: int = 260, columns: int = 8) -> Image.Image:
    """Every mask over its photo: found in green, missed in red, too much in blue, clicks as
    dots.
    """
    pictures = []
    for text, image, truth, mask, clicks in tiles:
        shown = image * 0.55
        for colour, region in (
            ((0, 200, 0), mask & truth),
            ((255, 0, 0), truth & ~mask),
            ((0, 80, 255), mask & ~truth),
        ):
            shown[region] += 0.45 * np.array(colour)
        picture = Image.fromarray(shown.clip(0, 255).astype(np.uint8)).resize(
            (width, 190)
        )
        draw = ImageDraw.Draw(picture)
        for kind, places in clicks.items():
            for _, x, y in places:
                left, top = x * width - 3, y * 190 - 3
                draw.ellipse(
                    (left, top, left + 6, top + 6),
                    fill="white" if kind == "positive" else "black",
                    outline="red",
                )
        draw.text((3, 2), text, fill="yellow")
        pictures.append(picture)
    sheet = Image.new("RGB", (columns * width, -(-len(pictures) // columns) * 190))
    for index, picture in enumerate(pictures):
        sheet.paste(picture, (index % columns * width, index // columns * 190))
    return sheet


# ---- seconds ----

ELSEWHERE = (0, 0.1, 0.85)  # photo, x and y of the click that warms up
ASIDE = 0.004  # the second click's distance from the first, whose answer is remembered
WORDS = ("dog",)  # of the detector `coco`


def seconds() -> None:
    """How long a click takes until the object is marked on both photos of a pair, and how much
    memory all small networks need together.

        python benchmarks/clicks.py seconds DATA [--size 512] [--segmenter auto] [--profile]

    DATA is a folder of photo sets, as for `benchmarks/clicks.py`. A first click elsewhere warms up
    what is read once for each photo. Then the object's own click is timed: seconds of the clock and
    of the processor until the mask of the clicked photo is there, which the app shows first, and
    until those of both photos are, carried by pictures and by geometry. The last line is the
    process's peak memory after all networks of `edit3r weights get essentials` were used.
    """
    parser = argparse.ArgumentParser(description=seconds.__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--size", type=int, default=512, help="longer side [pixels]")
    parser.add_argument("--segmenter", default="auto")
    parser.add_argument("--matcher", default="classical")
    parser.add_argument("--only", nargs="*", default=[], help="names of the objects")
    parser.add_argument(
        "--profile", action="store_true", help="show where the seconds go"
    )
    args = parser.parse_args()
    objects = json.loads(Path(__file__).with_name("clicks.json").read_text())
    segmenter = build("segmenter", args.segmenter)
    matcher = build("matcher", args.matcher)
    geometries: dict = {}
    profile = cProfile.Profile(time.process_time)
    rows = []
    for name, polygons in objects.items():
        files = tuple(args.data / file for file in polygons)
        if len(files) < 2 or (args.only and name not in args.only):
            continue
        views = load_views(files, size=args.size)
        images = views.images[0]
        if files not in geometries:
            geometries[files] = geometry_read(matcher, views)
            select_masks(images, Selection(positive=(ELSEWHERE,)), segmenter)
            segmenter.masks(images[1], [(ELSEWHERE[1:], True)])
        x, y = place_in(next(iter(polygons.values())), files[0])
        row = []
        asked = (
            (images[:1], None, 2 * ASIDE),
            (images, None, 0.0),
            (images, geometries[files], ASIDE),
        )
        for shown, geometry, aside in asked:
            clicked = Selection(positive=((0, x + aside, y),))
            clock, processor = time.perf_counter(), time.process_time()
            if args.profile:
                profile.enable()
            lenses = views.intrinsics[:, : len(shown)]
            found = select_masks(shown, clicked, segmenter, geometry, lenses)
            profile.disable()
            row += [time.perf_counter() - clock, time.process_time() - processor]
        rows.append(row)
        print(f"{name:16s} {told_of_seconds(row)}  ({found.how[1]})", flush=True)
    print(f"{'median':16s} {told_of_seconds(np.median(rows, axis=0))}")
    for word in WORDS:
        # what is not there: the networks are asked all the same
        with suppress(InputError):
            select_masks(images, Selection(words=word), segmenter)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory {peak:.2f} GB, {torch.get_num_threads()} threads")
    if args.profile:
        pstats.Stats(profile).sort_stats("tottime").print_stats(20)


def place_in(polygons: list, file: Path) -> tuple[float, float]:
    """The object's innermost point, x and y in [0, 1]."""
    width, height = Image.open(file).size
    truth = filled(polygons, (height, width))
    return next_click(np.zeros_like(truth), truth)[1]


def told_of_seconds(row) -> str:
    """Seconds for one photo, by pictures and by geometry, of the clock and of the processor."""
    heads = ("clicked photo", "CPU", "pictures", "CPU", "geometry", "CPU")
    return "  ".join(f"{head} {value:.2f} s" for head, value in zip(heads, row))


# ---- words ----

MATCHER = default_matcher(default_registry())

ABSENT = (
    "car",
    "dog",
    "horse",
    "bicycle",
    "sheep",
    "bus",
    "umbrella",
    "pizza",
    "guitar",
    "banana",
    "elephant",
    "train",
)
SEEN_BESIDE = {
    "berlin": {"bicycle", "car", "bus"},
    "dinosaur": {"car", "umbrella"},
    "british_museum": {"car", "bus", "umbrella"},
}
"""Words of ABSENT that may be on photos of a set after all."""


def words() -> None:
    """How well a word finds the thing, and how surely: objects of real photos whose outlines were
    drawn by hand (`clicks.json`), and words for things that the photos do not show.

        python benchmarks/clicks.py words DATA [--segmenter auto] [--only bear fox] [--beside]

    DATA is a folder of photo sets, as for `benchmarks/clicks.py`. An answer is right where its
    overlap with the outline is above one half; what is called sure is what a run takes unasked.
    With --beside another photo of the folder, two steps on, comes before the outlined one.
    """
    parser = argparse.ArgumentParser(description=words.__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--segmenter", default="auto")
    parser.add_argument("--only", nargs="*", default=[], help="names of the objects")
    parser.add_argument(
        "--beside", action="store_true", help="begin with another photo of the folder"
    )
    args = parser.parse_args()
    objects = json.loads(Path(__file__).with_name("clicks.json").read_text())
    segmenter = build("segmenter", args.segmenter)
    rows, absent, photos = [], [], set()
    for name, polygons in objects.items():
        file = next(iter(polygons))
        if (args.only and name not in args.only) or not (args.data / file).is_file():
            continue
        image = np.asarray(Image.open(args.data / file).convert("RGB"))
        truth = filled(polygons[file], image.shape[:2])
        tensor = torch.from_numpy(image.copy()).permute(2, 0, 1).float()[None] / 255
        if args.beside:
            tensor = torch.cat((beside(args.data / file, image.shape[1::-1]), tensor))
        rows.append((name, *answer(tensor, SAID.get(name, name), segmenter, truth)))
        print(
            "{:14} overlap {:.2f}  confidence {!s:.4}  {:.1f} s".format(*rows[-1]),
            flush=True,
        )
        if file in photos:
            continue
        photos.add(file)
        for word in set(ABSENT) - SEEN_BESIDE.get(file.split("/")[0], set()):
            _, confidence, _ = answer(tensor, word, segmenter, truth)
            absent.append(confidence)
            if (confidence or 0) >= SURE:
                print(f"  {word!r}, which is not there: {confidence:.2f} sure")
    told_of_words(rows, absent)


def beside(file: Path, size: tuple[int, int]) -> torch.Tensor:
    """The photo two steps on in the folder, in the other one's size."""
    files = sorted(file.parent.iterdir())
    place = files.index(file)
    other = files[place + 2 if place + 2 < len(files) else place - 2]
    image = np.asarray(Image.open(other).convert("RGB").resize(size))
    return torch.from_numpy(image.copy()).permute(2, 0, 1).float()[None] / 255


def answer(tensor, text, segmenter, truth) -> tuple[float, float | None, float]:
    """Overlap, confidence (None: not found) and seconds."""
    thing = usual_reader().read_target(text)
    asked = Selection(words=thing.name, qualifiers=thing.qualifiers)
    start = time.perf_counter()
    try:
        lens = intrinsics_from_fov(FOV, tensor.shape[-2:]).expand(1, len(tensor), 3, 3)
        geometry = geometry_read(MATCHER, Views(tensor[None], lens))
        found = select_masks(tensor, asked, segmenter, geometry, lens)
    except InputError:
        return 0.0, None, time.perf_counter() - start
    seconds = time.perf_counter() - start
    if "guess" in found.how:
        return 0.0, None, seconds
    return iou(found.masks[-1, 0].numpy() > 0.5, truth), found.confidence, seconds


def told_of_words(rows, absent) -> None:
    right = [row for row in rows if row[1] > 0.5]
    sure = [row for row in rows if (row[2] or 0) >= SURE]
    wrong = [row for row in sure if row[1] <= 0.5]
    unasked = sum((confidence or 0) >= SURE for confidence in absent)
    print(
        f"right: {len(right)} of {len(rows)}; sure: {len(sure)}, of these wrong: {len(wrong)}"
    )
    print(f"words of absent things: {len(absent)}, taken as sure: {unasked}")


# ---- questions ----

LIMITS = [round(0.01 * step, 2) for step in range(5, 61)]
Answer = tuple[str, float, bool]  # place, confidence, whether the answer is right


def questions() -> None:
    """The confidence below which a word is asked about instead of edited: words of two photos each
    whose answers were looked at (`questions.json`), and words that nothing here knows.

        python benchmarks/clicks.py questions DATA

    DATA holds the photos of `benchmarks/outlines.py` beside the photo sets. A limit is as bad as
    the right answers that it stops and the others that it lets pass; places are left out in turn.
    """
    parser = argparse.ArgumentParser(description=questions.__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    data = parser.parse_args().data
    asked = json.loads(Path(__file__).with_name("questions.json").read_text())
    answers: list[Answer] = []
    for place, one in asked.items():
        photos = load_views([data / name for name in one["photos"]])
        for kind in ("right", "wrong", "unknown"):
            for word in one[kind]:
                thing = usual_reader().read_target(word)
                asks = Selection(words=thing.name, qualifiers=thing.qualifiers)
                start, found = time.process_time(), select(photos, asks)
                cpu, confidence = time.process_time() - start, found.confidence or 1.0
                answers.append((place, confidence, kind == "right"))
                print(f"{place:20} {word:14} {kind:8} {confidence:.2f} {cpu:5.1f} s")
    places = {place for place, *_ in answers}
    parts = [_parted(answers, place) for place in places]
    left_out = sum(_mistakes(ours, _limit(others)) for ours, others in parts)
    limit = _limit(answers)
    print(
        f"limit {limit}: {_mistakes(answers, limit)} of {len(answers)} mistakes, "
        f"with the place left out {left_out}"
    )


def _parted(answers: list[Answer], place: str) -> tuple[list[Answer], list[Answer]]:
    ours = [one for one in answers if one[0] == place]
    return ours, [one for one in answers if one[0] != place]


def _mistakes(answers: list[Answer], limit: float) -> int:
    return sum((confidence >= limit) != right for _, confidence, right in answers)


def _limit(answers: list[Answer]) -> float:
    """The middle one of the best limits."""
    counts = [_mistakes(answers, limit) for limit in LIMITS]
    best = [limit for limit, count in zip(LIMITS, counts) if count == min(counts)]
    return best[len(best) // 2]


if __name__ == "__main__":
    run_benchmark(marks, seconds, words, questions)
