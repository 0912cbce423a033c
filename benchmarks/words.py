"""How well a word finds the thing, and how surely: objects of real photos whose outlines were drawn
by hand (`clicks.json`), and words for things that the photos do not show.

    python benchmarks/words.py DATA [--segmenter auto] [--only bear fox] [--beside]

DATA is a folder of photo sets, as for `benchmarks/clicks.py`. An answer is right where its overlap
with the outline is above one half; what is called sure is what a run takes unasked. With --beside
another photo of the folder, two steps on, comes before the outlined one.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from clicks import FOV, SAID, filled, iou
from edit3r_select.select import select_masks
from PIL import Image

from edit3r import Views, build, default_registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SURE, Selection
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.running import default_matcher, geometry_of, usual_reader

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
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
    told(rows, absent)


def beside(file: Path, size: tuple[int, int]) -> torch.Tensor:
    """The photo two steps on in the folder, in the other one's size."""
    files = sorted(file.parent.iterdir())
    place = files.index(file)
    other = files[place + 2 if place + 2 < len(files) else place - 2]
    image = np.asarray(Image.open(other).convert("RGB").resize(size))
    return torch.from_numpy(image.copy()).permute(2, 0, 1).float()[None] / 255


def answer(tensor, text, segmenter, truth) -> tuple[float, float | None, float]:
    """Overlap, confidence (None: not found) and seconds."""
    thing = usual_reader().read_thing(text)
    asked = Selection(words=thing.name, which=thing.which)
    start = time.perf_counter()
    try:
        lens = intrinsics_from_fov(FOV, tensor.shape[-2:]).expand(1, len(tensor), 3, 3)
        geometry = geometry_of(MATCHER, Views(tensor[None], lens))
        found = select_masks(tensor, asked, segmenter, geometry, lens)
    except InputError:
        return 0.0, None, time.perf_counter() - start
    seconds = time.perf_counter() - start
    if "guess" in found.how:
        return 0.0, None, seconds
    return iou(found.masks[-1, 0].numpy() > 0.5, truth), found.confidence, seconds


def told(rows, absent) -> None:
    right = [row for row in rows if row[1] > 0.5]
    sure = [row for row in rows if (row[2] or 0) >= SURE]
    wrong = [row for row in sure if row[1] <= 0.5]
    unasked = sum((confidence or 0) >= SURE for confidence in absent)
    print(
        f"right: {len(right)} of {len(rows)}; sure: {len(sure)}, of these wrong: {len(wrong)}"
    )
    print(f"words of absent things: {len(absent)}, taken as sure: {unasked}")


if __name__ == "__main__":
    main()
