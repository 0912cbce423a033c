"""A run's folder with the uncertainty of its scene: read, judged, written anew."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import build
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Rasterizer, SceneToWrite, SecondLook
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.contact_sheet import draw_sheet
from edit3r.kit.files.names import unique_names
from edit3r.kit.files.text import read_json
from edit3r.kit.geometry.paths import interpolate_poses
from edit3r.kit.photos.camera_files import read_scene_cameras
from edit3r.kit.photos.images import save_image
from edit3r.kit.rendering import render_each
from edit3r.kit.scenes.files import scene_file
from edit3r.kit.scenes.ply import save_ply
from edit3r.kit.scenes.reading import load_scene
from edit3r.running import RunFolder
from edit3r_uncertainty.api import render_uncertainty
from edit3r_uncertainty.signals import photos_of, uncertainty

# of the mean of red, green and blue, above which the edit changed a pixel; no figure kept
CHANGED = 0.05
COPIED = ("inputs", "edited", "masks", "renders")  # folders of a run that stay true


@dataclass(frozen=True)
class JudgedRun:
    """A scene (batch 1) with what it was made from."""

    root: Path
    gaussians: Gaussians
    cameras: Cameras
    names: tuple[str, ...]  # of the views
    photos: Float[Tensor, "view 3 height width"]
    edited: Float[Tensor, "view 3 height width"]
    manifest: dict[str, Any]  # content of run.json
    facts: Mapping[str, float] = field(default_factory=dict)  # what was found

    @property
    def sentence(self) -> str:
        """What was found, for a reader."""
        text = f"{self.facts['one_photo']:.0%} of the scene rests on one photo alone"
        if "edit_one_photo" in self.facts:
            text += f" ({self.facts['edit_one_photo']:.0%} of what the edit changed)"
        return (
            f"{text}: its depth is a guess. In a new view near the photos about "
            f"{self.facts['mean']:.0%} of the pixels will have a wrong colour."
        )


def read_run(root: Path) -> JudgedRun:
    """The run in a folder. Raises InputError, naming the file, for what is none."""
    scene = scene_file(str(root))
    root = root if root.is_dir() else root.parent
    folder = RunFolder(root)
    gaussians = load_scene(scene)
    if not (root / "inputs").is_dir():
        raise InputError(
            f"{root}: has no photos (its scene was edited, or the run kept no images); give a run "
            "with the folders inputs/ and edited/."
        )
    photos, edited = folder.read_views()
    cameras, _ = read_scene_cameras(folder.cameras)
    if (cameras.count, cameras.image_size) != (photos.count, photos.image_size):
        raise InputError(
            f"{folder.cameras}: has {cameras.count} cameras of {cameras.image_size} pixels, "
            f"expected one of {photos.image_size} for each of {photos.count} photos."
        )
    manifest = read_json(folder.manifest)
    images = photos.images[0], edited.images[0]
    return JudgedRun(root, gaussians, cameras, photos.names, *images, manifest)


def judge(run: JudgedRun, rasterizer: Rasterizer) -> JudgedRun:
    """The run with its scene's uncertainty, and shares of what its views show."""
    scene = run.gaussians
    number, shown = uncertainty(scene, run.cameras, run.edited, rasterizer)
    alone = photos_of(shown) <= 1
    total = shown.sum(0)
    facts = {
        "mean": _share(number[0], total),
        "one_photo": _share(alone.float(), total),
    }
    changed = ((run.edited - run.photos).abs().mean(1) > CHANGED).float()
    if changed.any():
        painted = rasterizer.contributions(scene, run.cameras, changed)[0]
        facts["edit_one_photo"] = _share(alone.float(), painted)
    return replace(run, gaussians=replace(scene, uncertainty=number), facts=facts)


def _share(
    values: Float[Tensor, "gaussian"], weights: Float[Tensor, "gaussian"]
) -> float:
    return float((values * weights).sum() / weights.sum().clamp(min=1e-6))


def write_run(root: Path, run: JudgedRun, rasterizer: Rasterizer, maps: bool) -> None:
    """Write the run's folder with the numbers in scene.ply, a sheet, and with `maps` each map."""
    folder = RunFolder(root)
    save_ply(folder.scene, run.gaussians)
    cameras, names = with_halfway(run)
    images = render_each(rasterizer, run.gaussians, cameras, "scene").images[0]
    found = render_uncertainty(rasterizer, run.gaussians, cameras)[0]
    columns = {"scene": images.clamp(0, 1), "uncertainty": coloured(found)}
    sheet = draw_sheet(columns, names=names, title=run.sentence)
    sheet.save(root / "uncertainty.png")
    unsure = run.gaussians.uncertainty
    assert unsure is not None  # it was estimated
    look = SecondLook(
        coloured(unsure[:, :, None])[0, :, :, 0].T, ("scene", "uncertainty")
    )
    scene = SceneToWrite(
        run.gaussians,
        run.cameras,
        names=run.names,
        title="what can be trusted",
        subtitle=run.sentence,
        second_look=lambda: look,
    )
    build("writer", "viewer").write(folder.viewer, scene)
    if maps:
        (root / "uncertainty").mkdir()
        for name, one in zip(names, found):
            save_image(one.expand(3, -1, -1), root / "uncertainty" / f"{name}.png")
    content = {**run.manifest, "uncertainty": dict(run.facts)}
    folder.continue_from(run.root, COPIED, content)


def with_halfway(run: JudgedRun) -> tuple[Cameras, list[str]]:
    """The photos' cameras, after each the one half-way to the next, and the names of all."""
    poses = run.cameras.c2w
    halfway = interpolate_poses(poses[:, :-1], poses[:, 1:], poses.new_tensor(0.5))
    every = Cameras(
        torch.cat((poses, halfway), 1),
        torch.cat((run.cameras.intrinsics, run.cameras.intrinsics[:, :-1]), 1),
        run.cameras.image_size,
    )
    count = run.cameras.count
    between = [f"between_{view}_{view + 1}" for view in range(count - 1)]
    names = unique_names([*run.names, *between])  # a photo may be called so too
    order = sorted(range(every.count), key=lambda place: place % count)
    return every.select(order), [names[place] for place in order]


def coloured(
    maps: Float[Tensor, "camera height width"],
) -> Float[Tensor, "camera 3 height width"]:
    """Maps in [0, 1] as colours, from dark (sure) to bright (uncertain)."""
    levels = (maps * 255).round().byte().cpu().numpy()
    images = [cv2.applyColorMap(one, cv2.COLORMAP_INFERNO)[..., ::-1] for one in levels]
    return torch.from_numpy(np.stack(images) / np.float32(255)).permute(0, 3, 1, 2)
