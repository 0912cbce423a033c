"""A flight through a scene along views that the user chose, as a video."""

import itertools
import math
from pathlib import Path
from typing import Annotated, Any

import torch
from edit3r_outputs.api import SavedScene
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edit3r import Registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.paths import interpolate_poses
from edit3r.kit.rendering import Flight
from edit3r.kit.scenes.files import scene_file
from edit3r.running import SceneInput
from edit3r_app.downloads import FILMS
from edit3r_app.jobs import JobsFolder

PER_LEG = 24  # pictures from one view to the next
MOST = 12  # views

Number = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]


class KeyView(BaseModel):
    """A camera as the viewer tells it: its axes right, down and forward, its centre, and fx, fy, cx
    and cy as shares of a photo.
    """

    model_config = ConfigDict(frozen=True)

    r: tuple[Vector, Vector, Vector]
    t: Vector
    K: tuple[Number, Number, Number, Number]

    @property
    def c2w(self) -> torch.Tensor:
        """Camera to world [4, 4], with axes at right angles."""
        pose = torch.eye(4, dtype=torch.float64)
        given = torch.tensor(self.r, dtype=torch.float64).T
        axes, _ = torch.linalg.qr(given)
        pose[:3, :3] = axes * (axes * given).sum(0).sign()  # not turned around
        pose[:3, 3] = torch.tensor(self.t, dtype=torch.float64)
        return pose


def read_keys(asked: Any) -> list[KeyView]:
    """The views of a flight; raises InputError for what is none."""
    try:
        keys = [KeyView.model_validate(one) for one in asked]
    except (ValidationError, TypeError):
        raise InputError("not views that can be flown along.") from None
    if not 2 <= len(keys) <= MOST:
        raise InputError(f"expected 2 to {MOST} views to fly along, got {len(keys)}.")
    if any(min(one.K[:2]) <= 0 or one.c2w[:3, :3].det() < 0.5 for one in keys):
        raise InputError("not views that can be flown along.")
    for number, (one, other) in enumerate(itertools.pairwise(keys), start=2):
        if one == other:
            raise InputError(
                f"view {number} is where view {number - 1} is; turn the scene before it is added."
            )
    return keys


def path_along(keys: list[KeyView], size: tuple[int, int]) -> Cameras:
    """Cameras from the first view to the last, slow near each view, at rest at the ends."""
    poses = torch.stack([one.c2w for one in keys])
    lenses = torch.tensor([one.K for one in keys], dtype=torch.float64)
    steps = torch.arange((len(keys) - 1) * PER_LEG + 1)
    leg = (steps // PER_LEG).clamp(max=len(keys) - 2)
    share = steps / PER_LEG - leg
    share = (share - torch.sin(2 * math.pi * share) / (2 * math.pi)).double()
    c2w = interpolate_poses(poses[leg], poses[leg + 1], share)
    lens = torch.lerp(lenses[leg], lenses[leg + 1], share[:, None])
    intrinsics = torch.eye(3, dtype=torch.float64).repeat(len(steps), 1, 1)
    intrinsics[:, 0, 0], intrinsics[:, 1, 1] = lens[:, 0], lens[:, 1]
    intrinsics[:, :2, 2] = lens[:, 2:]
    return Cameras(c2w[None].float(), intrinsics[None].float(), size)


def film(
    folder: JobsFolder,
    run: str,
    asked: Any,
    registry: Registry,
    given: SceneInput | None = None,
    plays_mp4: bool = False,
) -> Path:
    """Write the video of a flight beside a run, in place of the one before.

    `given` is the run's scene where one was given: its page has the frame of view 0.
    """
    keys = read_keys(asked)
    scene = scene_file(str(folder.path(run)))
    if not scene.is_file():
        raise InputError("there is no scene to fly through yet.")
    saved = SavedScene(scene, registry)
    path = path_along(keys, saved.cameras.image_size)
    rasterizer = registry.build("rasterizer", "auto")
    with torch.no_grad():
        gaussians = saved.gaussians if given is None else given.views.scene.gaussians
        scene_to_film = SceneToWrite(
            gaussians, frames=Flight(rasterizer, gaussians, path)
        )
        name = next(one for one in FILMS if _can_write(one, registry, plays_mp4))
        made = folder.beside(run) / name
        registry.build("writer", FILMS[name]).write(made, scene_to_film)
    return made


def _can_write(name: str, registry: Registry, plays_mp4: bool) -> bool:
    """Whether a film of that name can be made here and played there."""
    is_there = not registry.missing(registry.find("writer", FILMS[name]))
    return is_there and (plays_mp4 or not name.endswith(".mp4"))
