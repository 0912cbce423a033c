"""Draws outlines of objects on real photos by hand, as polygons, and shows them to be checked.

    python benchmarks/outlines.py DATA show PHOTO [--zoom 3] [--part X,Y,W,H] --out grid.png
    python benchmarks/outlines.py DATA add NAME PHOTO "x,y x,y ..." [--hole "..."]
    python benchmarks/outlines.py DATA check NAME|PHOTO [--zoom 3] [--part X,Y,W,H] --out check.png
    python benchmarks/outlines.py FOLDER fetch [--clones CLONES]

`fetch` brings the photos of `elsewhere.json` and `judged.json` from their public repositories into
FOLDER, or from clones OWNER+NAME in CLONES. DATA is a folder of photo sets, PHOTO a file in it such
as fern/images/000.jpg. Coordinates are pixels of the stored photo, whole numbers at the centres of
pixels. A pixel belongs to the object where it lies inside an odd number of its polygons.
"""

import argparse
import json
import subprocess
import urllib.request
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

FILE = Path(__file__).with_name("outlines.json")
ELSEWHERE = [
    Path(__file__).with_name(f"{name}.json") for name in ("elsewhere", "judged")
]
RAW = "https://raw.githubusercontent.com/{repository}/{commit}/{path}"
GRID = 10  # pixels of the photo between two lines; every second one is labelled
MARGIN = 12  # pixels of the photo shown around an object


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("job", choices=("show", "add", "check", "fetch"))
    parser.add_argument("names", nargs="*", help="see above")
    parser.add_argument("--hole", action="append", default=[], help="to cut out")
    parser.add_argument("--word", help="what a person would call the object")
    parser.add_argument("--more", action="store_true", help="keep the photo's polygons")
    parser.add_argument("--zoom", type=int, default=3)
    parser.add_argument("--part", help="X,Y,W,H of the photo to show")
    parser.add_argument("--out", type=Path, default=Path("outlines.png"))
    parser.add_argument("--clones", type=Path, help="folder of clones, OWNER+NAME")
    args = parser.parse_args()
    if args.job == "fetch":
        return fetch(args.data, args.clones)
    if not args.names:
        parser.error(f"{args.job} needs a name")
    objects = json.loads(FILE.read_text()) if FILE.exists() else {}
    part = [int(number) for number in args.part.split(",")] if args.part else None
    if args.job == "show":
        drawn(args.data, args.names[0], [], part, args.zoom).save(args.out)
    elif args.job == "add":
        add(objects, args)
        save(objects)
    else:
        check(objects, args.names[0], args.data, part, args.zoom).save(args.out)


def fetch(folder: Path, clones: Path | None) -> None:
    """Bring the photos of `elsewhere.json` and `judged.json`."""
    listed = [json.loads(file.read_text())["photos"] for file in ELSEWHERE]
    for name, source in (listed[0] | listed[1]).items():
        file = folder / name
        if file.is_file():
            continue
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content(source, clones))
        print(f"{name}: {source['repository']}, {source['licence']}")


def content(source: dict, clones: Path | None) -> bytes:
    """The photo's bytes, from a clone or from the network."""
    if clones is None:
        with urllib.request.urlopen(RAW.format(**source)) as answer:
            return answer.read()
    clone = clones / source["repository"].replace("/", "+")
    place = f"{source['commit']}:{source['path']}"
    command = ["git", "-C", str(clone), "show", place]
    return subprocess.run(command, check=True, capture_output=True).stdout


def add(objects: dict, args: argparse.Namespace) -> None:
    """Put the polygons under the object's photo, in place of those that were there."""
    name, photo, *texts = args.names
    polygons = [numbers(text) for text in [*texts, *args.hole]]
    entry = objects.setdefault(name, {"word": name.split("/")[1], "photos": {}})
    entry["word"] = args.word or entry["word"]
    kept = entry["photos"].get(photo, []) if args.more else []
    entry["photos"][photo] = kept + polygons


def numbers(text: str) -> list:
    return [[round(float(n), 1) for n in place.split(",")] for place in text.split()]


def save(objects: dict) -> None:
    """One object a line, so that a changed outline is a changed line."""
    lines = [
        f"{json.dumps(name)}: {json.dumps(objects[name], separators=(',', ':'))}"
        for name in sorted(objects)
    ]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def drawn(data: Path, photo: str, outlines: list, part: list | None, zoom: int):
    """The part of the photo, enlarged: with a grid, or with each outline in its own colour."""
    image = Image.open(data / photo).convert("RGB")
    x, y, width, height = part or (0, 0, *image.size)
    box = (x, y, min(x + width, image.width), min(y + height, image.height))
    size = ((box[2] - x) * zoom, (box[3] - y) * zoom)
    shown = image.crop(box).resize(size, Image.Resampling.BICUBIC)
    pen = ImageDraw.Draw(shown, "RGBA")
    for axis, start in enumerate((x, y)):
        for mark in range(start - start % -GRID, box[axis + 2], GRID):
            at = (mark - start + 0.5) * zoom
            line = ((at, 0), (at, size[1])) if axis == 0 else ((0, at), (size[0], at))
            labelled = mark % (2 * GRID) == 0
            if not outlines:
                pen.line(line, fill=(255, 255, 0, 110 if labelled else 50))
            if labelled:
                place = (at + 2, 0) if axis == 0 else (0, at)
                pen.text(
                    place, str(mark), fill="yellow", stroke_width=1, stroke_fill="black"
                )
    for number, polygons in enumerate(outlines):
        colour = ("red", "lime", "cyan", "magenta", "orange", "blue")[number % 6]
        for ring in polygons:
            places = [((px - x + 0.5) * zoom, (py - y + 0.5) * zoom) for px, py in ring]
            pen.line([*places, places[0]], fill=colour)
    return shown


def check(objects: dict, name: str, data: Path, part: list | None, zoom: int):
    """One object on each of its photos, side by side, or everything on one photo."""
    if name not in objects:
        outlines = [o["photos"][name] for o in objects.values() if name in o["photos"]]
        return drawn(data, name, outlines, part, zoom)
    shown = []
    for photo, polygons in objects[name]["photos"].items():
        places = np.concatenate(polygons)
        x, y = (int(n) for n in np.maximum(places.min(0) - MARGIN, 0))
        width, height = (int(n) for n in places.max(0) + MARGIN - (x, y))
        box = part or [x, y, width, height]
        shown.append(drawn(data, photo, [polygons], box, zoom))
    sheet = Image.new(
        "RGB", (sum(s.width for s in shown), max(s.height for s in shown))
    )
    for number, one in enumerate(shown):
        sheet.paste(one, (sum(s.width for s in shown[:number]), 0))
    return sheet


if __name__ == "__main__":
    main()
