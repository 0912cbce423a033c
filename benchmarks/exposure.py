"""Photos of one scene taken with other exposure and white balance: does the scene hold together?

    python benchmarks/exposure.py ../shared/data/fox ../shared/data/fern

Four photos of each folder's images/ are exposed anew: their linear light is multiplied (1, 0.55,
1.5 and 0.75 times, each with its white balance) and passes a camera's curve. Then whole default
runs: PSNR [dB] of the finished scene at its photos, and before refining, where the photos agree or
do not; with `--exposure own`, with `--exposure one`, and of the same photos as they were taken.
`--step` takes every so many photos of a folder.
"""

import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from harness import Row, run_benchmark
from skimage.io import imread, imsave
from skimage.transform import resize

import edit3r

EXPOSURES = (1.0, 0.55, 1.5, 0.75)
BALANCES = ((1, 1, 1), (1.1, 1, 0.88), (0.92, 1, 1.08), (1.05, 1, 0.95))
SHOULDER = 0.25  # of the curve x (1 + s) / (x + s): how early it bends towards white


def exposed(image: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """The sRGB photo [height width 3] as a camera would take it with `gain` times the light."""
    linear = np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
    scene = gain * SHOULDER * linear / (1 + SHOULDER - linear)
    shown = np.clip(scene * (1 + SHOULDER) / (scene + SHOULDER), 0, 1)
    return np.where(
        shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055
    )


def take(files: list[Path], folder: Path, change: bool) -> list[Path]:
    """Write the photos of 640 pixels into the folder, exposed anew where `change`."""
    written = []
    for index, file in enumerate(files):
        image = imread(file)[..., :3] / 255
        scale = 640 / max(image.shape)
        size = (round(scale * image.shape[0]), round(scale * image.shape[1]))
        image = resize(image, size, anti_aliasing=True)
        if change:
            image = exposed(image, EXPOSURES[index] * np.array(BALANCES[index]))
        written.append(folder / f"{change}{index}.png")
        imsave(written[-1], np.uint8(255 * image + 0.5), check_contrast=False)
    return written


def main(folders: Sequence[Path], *, step: int = 2, size: int = 384) -> Iterator[Row]:
    warnings.simplefilter("ignore")
    for folder in folders:
        files = sorted((folder / "images").iterdir())[::step][:4]
        with tempfile.TemporaryDirectory() as place:
            relit, plain = (
                take(files, Path(place), change) for change in (True, False)
            )
            for name, photos, exposure in (
                ("other light, own", relit, "own"),
                ("other light, one", relit, "one"),
                ("as taken", plain, "one"),
            ):
                result = edit3r.run(photos, editor="none", size=size, exposure=exposure)
                verdict = result.verdict
                shown, before = (
                    np.mean([one for one in values if one is not None])
                    for values in (verdict.input_psnr, verdict.agreement)
                )
                yield {
                    "scene": folder.name,
                    "run": name,
                    "verdict": verdict.label,
                    "photos [dB]": (shown, ".1f"),
                    "before refining [dB]": (before, ".1f"),
                }


if __name__ == "__main__":
    run_benchmark(main)
