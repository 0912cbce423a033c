"""Does a look that covers the whole photos reach all of the scene?

    python benchmarks/looks_in_3d.py DATA [--looks "black and white" night]

DATA is a folder of photo sets. For each pair: 36 frames of the camera path of the edited scene, and
of the scene without the edit. A pixel kept its own colour where it differs by less than 3 (CIE Lab)
from the scene without the edit and the look changes that by more than 10.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from harness import Row, run_benchmark

import edit3r
from edit3r import Views, build
from edit3r.contract.types import EditRequest
from edit3r.kit.compute.colour import rgb_to_lab
from edit3r.kit.rendering import path_around, render_one
from edit3r.running import usual_reader

PAIRS = {
    "fox": ("fox/images/0001.jpg", "fox/images/0006.jpg"),
    "bear": ("bear/images/frame_00001.jpg", "bear/images/frame_00005.jpg"),
    "tower": ("nle_tower/images/01.jpg", "nle_tower/images/06.jpg"),
    "opera house": ("soh_pair/images/000.jpg", "soh_pair/images/010.jpg"),
    "street": ("leuven_pair/images/leuvenA.jpg", "leuven_pair/images/leuvenB.jpg"),
    "motorcycle": (
        "stereo_motorcycle/images/left.jpg",
        "stereo_motorcycle/images/right.jpg",
    ),
}
FRAMES = 36
SIZE = 256
SAME, CHANGED = 3.0, 10.0  # differences of colours [CIE Lab]


def main(
    data: Path, *, looks: Sequence[str] = ("black and white", "night", "sketch")
) -> Iterator[Row]:
    editor = build("editor", "looks")
    for name, files in PAIRS.items():
        photos = [str(data / file) for file in files]
        plain = edit3r.run(photos, editor="none", size=SIZE, outputs=[])
        for look in looks:
            prompt = f"make the whole image {look}"
            edited = edit3r.run(photos, prompt, editor="looks", size=SIZE, outputs=[])
            shares = kept(plain, edited, editor, prompt)
            yield {
                "scene": name,
                "look": look,
                "pixels that kept their colour, mean": (float(shares.mean()), ".2%"),
                "worst frame": (float(shares.max()), ".2%"),
            }


def kept(plain, edited, looks, prompt) -> torch.Tensor:
    """Share of the pixels of each frame that kept their own colour."""
    path = path_around(plain.cameras, plain.rendered, FRAMES)
    shares = []
    for index in range(FRAMES):
        camera = path.select([index])
        before = render_one(plain.rasterizer, plain.gaussians, camera)
        after = render_one(edited.rasterizer, edited.gaussians, camera)
        image = before.images.clamp(0, 1)
        view = Views(image, camera.intrinsics)
        wanted = looks.edit(
            replace(view), EditRequest(prompt, instructions=usual_reader().read(prompt))
        ).images
        own = rgb_to_lab(image[0, 0])
        changes = (rgb_to_lab(wanted[0, 0]) - own).norm(dim=0) > CHANGED
        same = (rgb_to_lab(after.images[0, 0].clamp(0, 1)) - own).norm(dim=0) < SAME
        seen = before.alphas[0, 0, 0] > 0.5
        shares.append((same & changes & seen).double().mean())
    return torch.stack(shares)


if __name__ == "__main__":
    run_benchmark(main)
