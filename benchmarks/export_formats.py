"""What each export format costs and loses: `python benchmarks/export_formats.py [FOLDER]`, the
folder of a run; left out, the packaged pair with one Gaussian a pixel.

Size, CPU time, and the error after a round trip: of the centres and sizes as medians, in standard
deviations of the Gaussian itself; of the pictures from the run's cameras, against those of
scene.ply.
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from edit3r_outputs.api import load_scene

from edit3r import build
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.types import Gaussians
from edit3r.kit.photos.cameras import read_scene_cameras
from edit3r.kit.rendering import render_each

FORMATS = ("spz", "spz4", "sog", "splat", "compressed-ply", "glb", "ply")


def main(folder: Path) -> None:
    scene = load_scene(folder / "scene.ply")
    cameras, _ = read_scene_cameras(folder / "cameras.json")
    rasterizer = build("rasterizer", "auto")
    whole = render_each(rasterizer, scene, cameras, "").images.clamp(0, 1)
    print(
        "| format | MB | CPU s | centres | sizes | images |\n| --- | --: | --: | --: | --: | "
        "--: |"
    )
    with tempfile.TemporaryDirectory() as scratch:
        for form in FORMATS:
            writer = build("writer", form)
            file, start = Path(scratch) / writer.offer.component.file_name(), _cpu()
            writer.write(file, SceneToWrite(scene))
            spent = _cpu() - start
            back = load_scene(file)
            picture = render_each(rasterizer, back, cameras, "").images.clamp(0, 1)
            error = float((picture - whole).square().mean())
            psnr = f"{-10 * np.log10(error):.1f} dB" if error else "equal"
            centres, sizes = _errors(scene, back)
            print(
                f"| {form} | {file.stat().st_size / 1e6:.1f} | {spent:.1f} | {centres:.2%} | "
                f"{sizes:.2%} | {psnr} |"
            )


def _cpu() -> float:
    return sum(
        sum(resource.getrusage(who)[:2])
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )


def _errors(scene: Gaussians, back: Gaussians) -> tuple[float, float]:
    """Median errors of the centres and sizes, relative to the size; formats sort as they like, so
    by nearest centre.
    """
    from scipy.spatial import cKDTree

    gaps, index = cKDTree(back.means[0]).query(scene.means[0])
    size, found = (g.scales[0].double().mean(-1).numpy() for g in (scene, back))
    return float(np.median(gaps / size)), float(
        np.median(np.abs(found[index] / size - 1))
    )


def packaged(folder: Path) -> Path:
    """The folder of a run of the packaged pair with one Gaussian a pixel."""
    every = ["--gaussians", "all", "--refine", "0", "--grid", "1"]
    command = [sys.executable, "-m", "edit3r", "run", *every, "--quiet", "--out"]
    subprocess.run([*command, folder], check=True)
    return folder


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else packaged(Path(made) / "scene"))
