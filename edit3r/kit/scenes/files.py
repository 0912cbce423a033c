"""Where the file of a saved scene is."""

import re
from pathlib import Path

TRAINED = re.compile(r"iteration_(\d+)")
"""Folders that 3D Gaussian Splatting makes."""


def scene_file(text: str) -> Path:
    """Argument type of a saved scene: its file, or a folder that holds one.

    In a folder that is the `scene.ply` of a run, a scene of another format, or the last one that 3D
    Gaussian Splatting left there.
    """
    path = Path(text)
    if not path.is_dir():
        return path
    usual = [
        path / "scene.ply",
        *sorted(path.glob("scene.*")),
        path / "point_cloud.ply",
    ]
    endings = (".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb")
    usual = [one for one in usual if one.suffix.lower() in endings]
    trained = [
        folder / "point_cloud.ply"
        for place in (path, path / "point_cloud")
        for folder in sorted(place.glob("iteration_*"), key=_iteration, reverse=True)
    ]
    there = (one for one in [*usual, *trained] if one.is_file())
    return next(there, path / "scene.ply")


def _iteration(folder: Path) -> int:
    name = TRAINED.fullmatch(folder.name)
    return int(name[1][:9]) if name else -1
