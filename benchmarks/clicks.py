"""How well a click finds the thing: objects of real photos whose outlines were drawn by hand
(`clicks.json`).

    python benchmarks/clicks.py DATA [--segmenter classical] [--set size=256] [--only bear mug]
[--sheet OUT.png]

DATA is a folder of photo sets; an object whose photos are not there is left out with a sentence.
The first click is the object's innermost point, each further one the innermost point of the largest
wrong region, positive or negative: the usual protocol of interactive segmentation. The mask after
the last click is carried to the second photo twice, by the pictures and by the geometry that a
matcher reads from the pair.

People do not click on the innermost point. So six more first clicks lie anywhere on the object, and
the same six come with the object's name beside them. Three strokes lie on it too. The clicked photo
has the depth that it gets beside one or two photos of its folder, where these can be placed.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image, ImageDraw

from edit3r import Views, build
from edit3r.contract.errors import Edit3rError
from edit3r.kit.files.configs import parse_assignments
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.running import Selection, select_masks, usual_reader
from edit3r.running.selecting.geometry import locate

CLICKS = 3
ANYWHERE = 6  # first clicks a photo
INSIDE = 0.25  # how far from the outline these are, at least [the innermost point's distance]
STROKES = 3
STEPS = (1, 2, 3)  # to the neighbours in the folder that are tried
GOOD = 0.8  # IoU that a person takes without a second click
WORSE = 0.02  # a loss of IoU that a person sees
# stated for photos whose field of view nobody knows [radians]; the matcher reads its own
FOV = 1.05

SAID = {
    "opera house": "building",
    "plastic box": "box",
    "large mug": "mug",
    "wooden frame": "picture frame",
    "round mirror": "mirror",
}
"""The word that a person would say for an object, where it is not the object's name."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "data",
        type=Path,
        help="folder of photo sets, such as bear/images/frame_00001.jpg",
    )
    parser.add_argument("--segmenter", default="classical")
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
        help="outlines by object and photo; as a value also {word, photos}",
    )
    parser.add_argument(
        "--sheet", type=Path, help="picture of every mask, true outline in white"
    )
    args = parser.parse_args()
    objects = json.loads(args.objects.read_text())
    segmenter = build("segmenter", args.segmenter, **parse_assignments(args.set))
    matcher = build("matcher", args.matcher) if args.matcher else None
    rows, aside, drawn, tiles, geometries = [], [], [], [], {}
    for name, photos in objects.items():
        if args.only and name not in args.only:
            continue
        word = SAID.get(name, name)
        if "photos" in photos:
            word, photos = photos["word"], photos["photos"]
        missing = [file for file in photos if not (args.data / file).is_file()]
        if missing:
            print(f"{name}: left out, {args.data / missing[0]} is not there")
            continue
        images = [
            np.asarray(Image.open(args.data / file).convert("RGB")) for file in photos
        ]
        truths = [
            filled(polygons, image.shape[:2])
            for polygons, image in zip(photos.values(), images)
        ]
        first = args.data / next(iter(photos))
        depth = depth_of(first, matcher, geometries)
        scores = scores_of(
            name, images, truths, segmenter, matcher, geometries, tiles, depth
        )
        loose = [
            anywhere(images[0], truths[0], segmenter, words, depth)
            for words in ("", usual_reader().read_thing(word).name)
        ]
        drawn.append(stroked(images[0], truths[0], segmenter, depth))
        aside.append(loose)
        rows.append((*scores, *np.mean(loose, axis=1)))
        print(line(name, rows[-1]), flush=True)
    print(
        line(
            f"mean of {len(rows)}",
            np.array([[np.nan if v is None else v for v in row] for row in rows]),
        )
    )
    print(summary(rows))
    good = (np.array(aside) >= GOOD).mean((0, 2))
    print(
        f"the same after a click anywhere: {good[0]:.0%}; with its name: {good[1]:.0%}"
    )
    strokes = np.array(drawn)
    print(
        f"strokes: mean {strokes.mean():.3f}, below 0.5: {(strokes < 0.5).mean():.0%}"
    )
    if args.sheet and tiles:
        contact_sheet(tiles).save(args.sheet)


def filled(polygons: list, shape: tuple[int, int]) -> np.ndarray:
    """Bool mask `[H, W]` inside an odd number of polygons."""
    inside = np.zeros(shape, dtype=bool)
    for polygon in polygons:
        canvas = Image.new("1", shape[::-1])
        ImageDraw.Draw(canvas).polygon([tuple(place) for place in polygon], fill=1)
        inside ^= np.asarray(canvas)
    return inside


def scores_of(name, images, truths, segmenter, matcher, geometries, tiles, depth):
    """IoU after each click, carried by pictures and by geometry (None where there is no second
    photo), CPU seconds.
    """
    tensors = [
        torch.from_numpy(image.copy()).permute(2, 0, 1).float() / 255
        for image in images
    ]
    clicks: dict[str, list] = {"positive": [], "negative": []}
    mask, scores, seconds = np.zeros_like(truths[0]), [], []
    for _ in range(CLICKS):
        kind, place = next_click(mask, truths[0])
        clicks[kind].append((0, *place))
        selection = Selection(**{key: tuple(places) for key, places in clicks.items()})
        start = time.process_time()
        soft = select_masks(tensors[0][None], selection, segmenter, *depth).masks[0, 0]
        seconds.append(time.process_time() - start)
        mask = soft.numpy() > 0.5
        scores.append(iou(mask, truths[0]))
        tiles.append(
            (
                f"{name}, {len(scores)} clicks: {scores[-1]:.2f}",
                images[0],
                truths[0],
                mask,
                dict(clicks),
            )
        )
    carried = [None, None]
    if len(images) > 1:
        frames = [tensors[0], resized(tensors[1], tensors[0].shape[-2:])]
        truth = cv2.resize(truths[1].astype(np.uint8), truths[0].shape[::-1]) > 0
        geometry = geometry_of(frames, matcher, geometries)
        for index, found in enumerate([None, geometry]):
            if index == 1 and found is None:
                continue
            lens = intrinsics_from_fov(FOV, tuple(frames[0].shape[-2:])).expand(
                1, 2, 3, 3
            )
            # The mask of photo 1 as it came out, so that this measures the carrying and what the
            # clicks left wrong.
            given = Selection(masks={0: soft})
            selected = select_masks(torch.stack(frames), given, segmenter, found, lens)
            there = selected.masks[1, 0].numpy() > 0.5
            carried[index] = iou(there, truth)
            picture = (frames[1].permute(1, 2, 0).numpy() * 255).astype(np.uint8)
            tiles.append(
                (
                    f"{name}, carried ({selected.how[1]}): {carried[index]:.2f}",
                    picture,
                    truth,
                    there,
                    {},
                )
            )
    return (*scores, *carried, float(np.mean(seconds)))


def depth_of(photo, matcher, known):
    """Geometry of a photo alone and its intrinsics, read beside its neighbours in the folder; two
    Nones where they cannot be placed.
    """
    if photo in known:
        return known[photo]
    known[photo] = (None, None)
    files = sorted(photo.parent.iterdir())
    place = files.index(photo)
    for step in STEPS if matcher is not None else ():
        chosen = [place, place - step, place + step, place + 2 * step]
        chosen = [index for index in chosen if 0 <= index < len(files)][:3]
        images = [as_tensor(files[index]) for index in chosen]
        frames = torch.stack([resized(one, images[0].shape[-2:]) for one in images])
        lens = intrinsics_from_fov(FOV, tuple(frames.shape[-2:]))
        lens = lens.expand(1, len(frames), 3, 3)
        views = Views(frames[None], lens, assumed=(True,) * len(frames))
        found = locate(matcher, views)
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
    pixels = np.asarray(Image.open(file).convert("RGB"))
    return torch.from_numpy(pixels.copy()).permute(2, 0, 1).float() / 255


def stroked(image, truth, segmenter, depth):
    """IoU of some strokes on the object: straight lines, as long as most that fit there."""
    tensor = torch.from_numpy(image.copy()).permute(2, 0, 1).float()[None] / 255
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
    """IoU after each of some first clicks anywhere on the object, always at the same places."""
    deep = cv2.distanceTransform(truth.astype(np.uint8), cv2.DIST_L2, 5)
    inner = np.argwhere(deep > INSIDE * deep.max())
    chosen = np.random.default_rng(7).choice(len(inner), ANYWHERE)
    tensor = torch.from_numpy(image.copy()).permute(2, 0, 1).float()[None] / 255
    found = []
    for row, column in inner[chosen]:
        place = (column + 0.5) / truth.shape[1], (row + 0.5) / truth.shape[0]
        selection = Selection(positive=((0, *place),), words=words)
        soft = select_masks(tensor, selection, segmenter, *depth).masks[0, 0]
        found.append(iou(soft.numpy() > 0.5, truth))
    return found


def geometry_of(frames, matcher, known):
    """What the matcher reads from a pair, once per pair; None where it cannot place the photos."""
    key = hash(tuple(float(frame.sum()) for frame in frames))
    if matcher is not None and key not in known:
        lens = intrinsics_from_fov(FOV, tuple(frames[0].shape[-2:])).expand(1, 2, 3, 3)
        try:
            known[key] = matcher.match(
                Views(torch.stack(frames)[None], lens, assumed=(True, True))
            )
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


def line(name: str, row) -> str:
    """One line of the table, of one row or the mean of many `[N, 8]`, leaving gaps out."""
    values = (
        np.array([np.nan if v is None else v for v in row])
        if np.ndim(row) == 1
        else np.nanmean(row, axis=0)
    )
    heads = "1 click", "2", "3", "pictures", "geometry", "CPU s", "anywhere", "named"
    return f"{name:16s}" + "".join(
        f"  {head} {value:.2f}" for head, value in zip(heads, values)
    )


def summary(rows: list) -> str:
    """Share of good masks after one click, and how often a correcting click made a mask worse."""
    scores = np.array([row[:CLICKS] for row in rows], dtype=float)
    worse = (np.diff(scores, axis=1) < -WORSE).sum()
    good = (scores[:, 0] >= GOOD).mean()
    return (
        f"IoU of {GOOD} or more after one click: {good:.0%}; "
        f"made worse by {worse} of {scores[:, 1:].size} correcting clicks"
    )


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


if __name__ == "__main__":
    main()
