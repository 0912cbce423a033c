"""Does what continues the photos beyond their borders take the edit of the border it continues?

    python benchmarks/rim.py DATA [--size 512] [--only "pink sky"] [--sheet OUT.png]

DATA is a folder of photo sets. Six edits that a mask or a region confines. The scene is seen from
the place of each photo by a wider camera. Of the stretches of each border that the edit covers, the
mean colour of the edited photo, in the scene's light, is compared with the mean of what its own
Gaussians show beyond. One row an edit: levels of 255 between the two for each border (four of each
photo), their mean and the worst; and how much of the steps from pixel to pixel along the border is
left beyond it (stripes).
"""

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from clicks import filled
from harness import Row, run_benchmark
from PIL import Image

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.contract.types import Cameras
from edit3r.kit.rendering import render_one

BEYOND = 0.12  # how far the wider camera looks past the photo [longer sides]
STRETCH = 0.06  # length of one stretch of the border [longer sides]
INNER = 0.03  # depth of the photo's border that is compared [longer sides]
OUTER = 0.08  # depth of what lies beyond it
SEEN = 0.3  # opacity below which a pixel shows nothing

SKY, STREET = ("soh_pair", "000", "010"), ("leuven_pair", "leuvenA", "leuvenB")


@dataclass(frozen=True)
class Case:
    """One masked edit of two photos."""

    photos: tuple[str, str, str]  # folder, first photo, second
    prompt: str
    outline: str = ""  # the object of `clicks.json` that is edited; "": by the words
    all_but: bool = False


CASES = {
    "pink sky": Case(SKY, "make the sky pink"),
    "grey around the motorcycle": Case(
        ("stereo_motorcycle", "left", "right"),
        "make it black and white",
        "motorcycle",
        True,
    ),
    "blue around the bear": Case(
        ("bear", "frame_00001", "frame_00005"), "make it blue", "bear", True
    ),
    "grey around the fox": Case(
        ("fox", "0001", "0006"), "make it black and white", "fox", True
    ),
    "green around the dinosaur": Case(
        ("dinosaur", "frame_00001", "frame_00007"), "make it green", "dinosaur", True
    ),
    "darker around the magazine": Case(
        ("7scenes_rgbd", "frame-000326", "frame-000490"),
        "make it darker",
        "magazine",
        True,
    ),
}


def main(
    data: Path, *, size: int = 512, only: Sequence[str] = (), sheet: Path | None = None
) -> Iterator[Row]:
    pictures = []
    for name, case in CASES.items():
        if only and name not in only:
            continue
        try:
            result = done(case, data, size)
        except Edit3rError as error:
            print(f"{name}: {str(error)[:90]}")
            continue
        wide = [wider(result, view) for view in range(2)]
        borders = [one for view in wide for one in compared(*view)]
        levels, stripes = np.array(borders).T
        yield {
            "edit": name,
            "borders": (len(levels), "d"),
            "levels, mean": (levels.mean(), ".1f"),
            "worst": (levels.max(), ".1f"),
            "stripes": (stripes.mean(), ".2f"),
        }
        pictures.append(wide[0][0])
    if sheet:
        in_rows(pictures).save(sheet)


def done(case: Case, data: Path, size: int) -> edit3r.RunResult:
    """The run of one case."""
    folder, *names = case.photos
    files = [data / folder / "images" / f"{name}.jpg" for name in names]
    with tempfile.TemporaryDirectory() as place:
        masks = []
        if case.outline:
            outlines = json.loads(Path(__file__).with_name("clicks.json").read_text())
            for file in files:
                polygons = outlines[case.outline][str(file.relative_to(data))]
                shape = np.asarray(Image.open(file)).shape[:2]
                mask = filled(polygons, shape) != case.all_but
                masks.append(Path(place) / f"{file.stem}.png")
                Image.fromarray((mask * 255).astype(np.uint8)).save(masks[-1])
        marks = {"masks": masks} if masks else {}
        return edit3r.run(
            [str(file) for file in files], case.prompt, size=size, outputs=[], **marks
        )


def wider(result: edit3r.RunResult, view: int) -> tuple[torch.Tensor, ...]:
    """The scene from a photo's place with room around it; the photo's own Gaussians' colours there,
    and where they show; photo and mask, padded to the same size.
    """
    cameras = result.cameras
    height, width = cameras.image_size
    pad = round(BEYOND * max(height, width))
    intrinsics = cameras.intrinsics[:, [view]].clone()
    for axis, side in enumerate((width, height)):
        intrinsics[..., axis, axis] *= side / (side + 2 * pad)
        offset = intrinsics[..., axis, 2] * side + pad
        intrinsics[..., axis, 2] = offset / (side + 2 * pad)
    camera = Cameras(
        cameras.c2w[:, [view]], intrinsics, (height + 2 * pad, width + 2 * pad)
    )
    whole = render_one(result.rasterizer, result.gaussians, camera)
    gaussians = result.gaussians.select(result.gaussians.view_index == view)
    own = render_one(result.rasterizer, gaussians, camera)
    alphas = own.alphas[0, 0, 0]
    colours = own.images[0, 0] / alphas.clamp(min=SEEN)
    edges = (pad, pad, pad, pad)
    edited = result.records.located.in_one_exposure(result.edited)
    photo = F.pad(edited.images[0, view], edges)
    mask = F.pad(result.masks[0, view], edges)
    return whole.images[0, 0], colours, alphas > SEEN, photo, mask


def compared(whole, colours, shown, photo, mask) -> Iterator[tuple[float, float]]:
    """For each border: levels between its stretches that the edit covers and what lies beyond them,
    and what is left of their steps.
    """
    pad = round(BEYOND * max(mask.shape) / (1 + 2 * BEYOND))
    side = max(mask.shape) - 2 * pad
    deep, far, long = (round(share * side) for share in (INNER, OUTER, STRETCH))
    inner, outer = slice(pad, pad + deep), slice(pad - far, pad)
    for turn in range(4):  # each border in turn lies on top
        parts = (colours, shown[None], photo, mask[None])
        new, beyond, old, where = (torch.rot90(one, turn, (1, 2)) for one in parts)
        differences, steps = [], []
        for left in range(pad, new.shape[2] - pad - long + 1, long):
            along = slice(left, left + long)
            counted = beyond[0, outer, along]
            if where[0, inner, along].min() < 0.5 or counted.double().mean() < 0.5:
                continue
            wanted, there = old[:, inner, along], new[:, outer, along]
            differences.append(there[:, counted].mean(1) - wanted.mean((1, 2)))
            rough = [one.mean(1).diff(dim=1).abs().mean() for one in (there, wanted)]
            steps.append(float(rough[0] / rough[1].clamp(min=1e-3)))
        if differences:
            mean = torch.stack(differences).mean(0).abs().mean()
            yield float(255 * mean), float(np.mean(steps))


def in_rows(pictures: list[torch.Tensor]) -> Image.Image:
    """The pictures in rows of three."""
    tiles = []
    for picture in pictures:
        pixels = (picture.clamp(0, 1) * 255).byte().permute(1, 2, 0).numpy()
        tile = Image.fromarray(pixels)
        tile.thumbnail((480, 480))
        tiles.append(tile)
    whole = Image.new("RGB", (3 * 480, -(-len(tiles) // 3) * 480))
    for number, tile in enumerate(tiles):
        whole.paste(tile, (number % 3 * 480, number // 3 * 480))
    return whole


if __name__ == "__main__":
    run_benchmark(main)
