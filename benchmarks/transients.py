"""People pasted into one of three photos: do they leave ghosts at views that no run was given?

    python benchmarks/transients.py DATA
    python benchmarks/transients.py DATA fox,0,0 fern,0,1

DATA holds the sets of docs/notes/scenes.md. The photos n, n + 2 and n + 4 of a set (`fox,0,0`: its
name, n, and which of the three somebody walks through) are reconstructed without their poses: as
they are, with a person of `benchmarks/outlines.json` pasted in and drawn, and with the person left
out. Photos between are rendered from their true poses; printed is the mean PSNR [dB] where the
person would be, if it lay on the surface behind, and elsewhere.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
import verdict

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.photos.posed_folder import read_posed_folder

PEOPLE = ("girl", "lady", "man in sweater", "woman in white")  # of british_museum
PLACES = {  # middle [width], feet [height], height [height], of each case
    "fox,0,0": (0.35, 0.95, 0.35),
    "fox,25,1": (0.6, 0.7, 0.3),
    "fern,0,1": (0.5, 0.95, 0.45),
    "fern,10,2": (0.3, 0.9, 0.5),
    "bear,0,0": (0.7, 0.8, 0.45),
    "7scenes_rgbd,0,1": (0.5, 0.95, 0.5),
    "7scenes_rgbd,12,2": (0.6, 0.9, 0.45),
    "monstree,0,1": (0.4, 0.95, 0.4),
}
SIZE = 256
AROUND = 4  # pixels around a person that belong to its area


def person(data: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Colours in [0, 1] and outline of somebody, cut to its box."""
    outlines = json.loads(Path(__file__).with_name("outlines.json").read_text())
    file, polygons = next(iter(outlines[f"british_museum/{name}"]["photos"].items()))
    image = cv2.imread(str(data / file))[..., ::-1].astype(np.float32) / 255
    mask = np.zeros(image.shape[:2], np.float32)
    cv2.fillPoly(mask, [np.round(one).astype(np.int32) for one in polygons], 1.0)
    row, column = np.nonzero(mask)
    box = np.s_[row.min() : row.max() + 1, column.min() : column.max() + 1]
    return image[box], mask[box]


def pasted(
    photo: torch.Tensor, who: tuple[np.ndarray, np.ndarray], place: tuple[float, ...]
) -> tuple[torch.Tensor, torch.Tensor]:
    """The photo (3, height, width) with somebody in it, and where."""
    height, width = photo.shape[1:]
    tall = int(place[2] * height)
    wide = max(4, tall * who[1].shape[1] // who[1].shape[0])
    colours, mask = (
        cv2.resize(part, (wide, tall), interpolation=cv2.INTER_AREA) for part in who
    )
    top, left = int(place[1] * height) - tall, int(place[0] * width - wide / 2)
    box = np.s_[:, top : top + tall, left : left + wide]
    share = torch.zeros_like(photo[:1])
    share[box] = torch.from_numpy(mask)
    layer = torch.zeros_like(photo)
    layer[box] = torch.from_numpy(colours).permute(2, 0, 1)
    return photo.lerp(layer, share), share[0] > 0.5


class Run:
    """One reconstruction, seen from photos that it was not given."""

    def __init__(self, given: edit3r.Views, all_views: edit3r.Views, choice: str):
        self.views = all_views
        self.result = edit3r.run(
            replace(given, c2w=None), editor="none", size=SIZE, transients=choice
        )

    def camera(self, pair: int, target: int) -> edit3r.Cameras:
        """Where `target` stands beside the nearer of the photos `pair` and `pair` + 1."""
        true, found = self.views.c2w[0].double(), self.result.cameras.c2w[0].double()
        length, own = (
            float((poses[pair, :3, 3] - poses[pair + 1, :3, 3]).norm())
            for poses in (true, found)
        )
        near = min(
            (pair, pair + 1),
            key=lambda view: float((true[view, :3, 3] - true[target, :3, 3]).norm()),
        )
        step = torch.linalg.inv(true[near]) @ true[target]
        step[:3, 3] *= own / length
        pose = (found[near] @ step).float()[None, None]
        intrinsics = self.views.intrinsics[:, [target]]
        return edit3r.Cameras(pose, intrinsics, self.views.image_size)

    def error(self, pair: int, target: int) -> torch.Tensor:
        """Squared error of each pixel of `target`."""
        image = self.result.rasterizer.render(
            self.result.gaussians, self.camera(pair, target)
        ).images[0, 0]
        return (image.clamp(0, 1) - self.views.images[0, target]).square().mean(0)

    def area(
        self, mask: torch.Tensor, view: int, pair: int, target: int
    ) -> torch.Tensor:
        """Where in `target` the surface lies that `view` shows within the mask."""
        own = self.result.cameras.select([view])
        seen = self.result.rasterizer.render(self.result.gaussians, own)
        points = unproject(seen.depths[:, :, 0], own.intrinsics, own.c2w)[0, 0][mask]
        camera = self.camera(pair, target)
        pixels, depth = project(points[None], camera.intrinsics[0], camera.c2w[0])
        inside = (depth > 0) & (pixels > 0).all(-1) & (pixels < 1).all(-1)
        height, width = camera.image_size
        column, row = (pixels[inside] * torch.tensor([width, height])).long().T
        area = torch.zeros(1, height, width)
        area[0, row, column] = 1
        return dilate(area, AROUND)[0] > 0


@torch.no_grad()
def measure(data: Path, case: str) -> str:
    """A row of the table."""
    scene, start, into = case.split(",")
    chosen, view = [int(start) + gap for gap in (0, 2, 4)], int(into)
    cameras = read_posed_folder(data / scene).cameras
    centres = np.stack([camera.c2w[:3, 3] for camera in cameras])
    targets = verdict.between(centres, chosen)
    wanted = [(pair, target) for pair, target in enumerate(targets) if target]
    files = [cameras[i].file for i in (*chosen, *(target for _, target in wanted))]
    views = edit3r.load_views([data / scene / file for file in files], size=SIZE)
    given = views.select(range(3))
    who = person(data, PEOPLE[list(PLACES).index(case) % len(PEOPLE)])
    images = given.images.clone()
    images[0, view], mask = pasted(images[0, view], who, PLACES[case])
    walked = replace(given, images=images)
    runs = [
        Run(one, views, choice)
        for one, choice in (
            (given, "keep"),
            (given, "leave-out"),
            (walked, "keep"),
            (walked, "leave-out"),
        )
    ]
    inside, outside = ([[] for _ in runs] for _ in range(2))
    for number, (pair, _) in enumerate(wanted):
        area = runs[0].area(mask, view, pair, 3 + number)
        for run, there, rest in zip(runs, inside, outside):
            error = run.error(pair, 3 + number)
            there.append(float(-10 * error[area].mean().log10()))
            rest.append(float(-10 * error[~area].mean().log10()))
    shown = (f"{np.mean(values):.2f}" for values in (*inside, *outside))
    return f"| {case} | {' | '.join(shown)} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("cases", nargs="*", default=list(PLACES))
    args = parser.parse_args()
    runs = "as it is | as it is, searched | drawn | left out"
    print(f"| case | {runs} | elsewhere: {runs} |\n| --- |{' --: |' * 8}")
    for case in args.cases:
        try:
            print(measure(args.data, case), flush=True)
        except Edit3rError as error:
            print(f"| {case} | {error} |", flush=True)


if __name__ == "__main__":
    main()
