"""NoPoSplat's evaluation of reconstruction (Ye et al., ICLR 2025): index files, aligned cameras,
AUC of poses.

An index file is JSON as of pixelSplat: {scene: {"context": [a, b], "target": [...], "overlap": 0.4}
or null}, numbers of frames; a list of such entries gives a scene several pairs.

A scene from two photos without poses stands in a frame and a unit of length of its own, so a true
camera stands a little beside the place that its photo shows. The protocol moves it there, the scene
frozen, before it compares.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.config import Settings, make_settings
from edit3r.contract.interfaces import (
    Dataset,
    Loss,
    LossInputs,
    Rasterizer,
    Reconstructor,
)
from edit3r.contract.types import Cameras, Gaussians
from edit3r.errors import InputError
from edit3r.geometry.cameras import invert_rigid
from edit3r.geometry.rotations import cross_matrix, matrices_to_quats
from edit3r.io.posed_folder import Photo, read_posed_folder
from edit3r_measure.metrics import psnr, ssim
from edit3r_measure.novel_view import (
    pose_errors,
    predicted_pose,
    target_camera,
    views_of,
)
from edit3r_measure.report import read_json

# step of Adam, of a turn [radians] and of a shift [distances between the input cameras]
RATE = 0.005
# of the perceptual distance beside the mean squared error, as in the training of NoPoSplat
WEIGHT = 0.05
STRUCTURE_ENOUGH = 0.98  # likeness of structure from which more of it is not asked for

AUC_DEGREES = (5, 10, 20)
# Overlap of two photos, as NoPoSplat's tables are divided; what is in none of them is left out
# there
CLASSES = {"small": (0.05, 0.3), "medium": (0.3, 0.55), "large": (0.55, 0.8)}
Frame = Annotated[int, Field(ge=0)]
Picture = Float[Tensor, "1 1 3 height width"]
Compare = Callable[[Picture, Picture], Float[Tensor, ""]]


class Entry(Settings):
    """One pair of an index file."""

    context: tuple[Frame, ...] = Field(
        min_length=2, description="frames that are given"
    )
    target: tuple[Frame, ...] | Frame = Field(description="frames that are predicted")
    overlap: float | str | None = Field(
        None, description="share of one photo that the other shows, or a class"
    )

    @property
    def targets(self) -> tuple[int, ...]:
        return (self.target,) if isinstance(self.target, int) else self.target

    @property
    def overlap_class(self) -> str:
        """Key of CLASSES; "not classed" for other overlaps and where none is told (the published
        placeholder is -1).
        """
        if isinstance(self.overlap, float):
            return next(
                (
                    name
                    for name, (low, high) in CLASSES.items()
                    if low <= self.overlap <= high
                ),
                "not classed",
            )
        return self.overlap if self.overlap in CLASSES else "not classed"


def read_index(path: Path) -> list[tuple[str, Entry]]:
    """Return scenes and pairs of an index file, null ones left out. Raises InputError naming file
    and scene.
    """
    if not path.is_file():
        raise InputError(
            f"{path}: no such index file; benchmarks/overlap_index.py makes one."
        )
    content = read_json(path)
    if not isinstance(content, Mapping):
        raise InputError(
            f'{path}: expected {{scene: {{"context": [a, b], "target": [...]}}}} as pixelSplat '
            "has it."
        )
    pairs = []
    for scene, own in content.items():
        for entry in own if isinstance(own, list) else [own]:
            if entry is not None:
                values = entry if isinstance(entry, dict) else {}
                known = {
                    key: values[key] for key in Entry.model_fields if key in values
                }
                pairs.append(
                    (scene, make_settings(Entry, known, where=f"{path.name}, {scene}"))
                )
    return pairs


def photos_of(
    places: Sequence[str | Dataset], scene: str, indices: Sequence[int], size: int
) -> list[Photo]:
    """Load frames of a scene: of a folder of that name among the places or inside one, or of a data
    set that has it.
    """
    for place in places:
        if isinstance(place, Dataset):
            if not hasattr(place, "photos"):
                raise InputError(
                    f"{type(place).__name__} has no scenes by name, as re10k has; give folders "
                    "of photos."
                )
            return place.photos(scene, indices)
        for folder in (Path(place), Path(place) / scene):
            if folder.resolve().name == scene and folder.is_dir():
                found = read_posed_folder(folder)
                if max(indices) >= len(found.cameras):
                    have = f"{len(found.cameras)} photos with known cameras"
                    raise InputError(
                        f"{folder}: the index asks for frame {max(indices)}, it has {have}."
                    )
                return [found.load(index, size) for index in indices]
    raise InputError(f"{scene}: a scene of the index that no folder given is or holds.")


def align(
    scene: tuple[Gaussians, Rasterizer],
    camera: Cameras,
    photo: Picture,
    compare: Compare,
    steps: int,
    unit: float,
) -> Cameras:
    """Return `camera` (one, batch 1) moved to where the frozen scene looks most like `photo`, by
    `steps` of Adam.

    `unit` is the distance between the input cameras. Of all places on the way the best is returned,
    so it is never worse than the first by `compare` (the published code takes the last).
    """
    (gaussians, rasterizer), c2w, best = (
        scene,
        camera.c2w[0, 0].double(),
        (float("inf"), camera),
    )
    turn, shift = (
        torch.zeros(3, dtype=torch.float64, requires_grad=True) for _ in range(2)
    )
    adam = torch.optim.Adam([turn, shift], lr=RATE)
    for _ in range(steps + 1):
        here = replace(camera, c2w=c2w[None, None].to(camera.c2w))
        with torch.enable_grad():
            motion = _motion(turn, shift * unit)
            moved = _moved(gaussians, c2w @ motion @ invert_rigid(c2w))
            value = compare(rasterizer.render(moved, here).images, photo)
            adam.zero_grad()
            value.backward()
        best = min(best, (value.item(), here), key=lambda place: place[0])
        adam.step()
        with (
            torch.no_grad()
        ):  # the step is taken by the camera, and the next one begins at zero
            c2w = c2w @ invert_rigid(_motion(turn, shift * unit))
            turn.zero_(), shift.zero_()
    return best[1]


def _motion(
    turn: Float[Tensor, "3"], shift: Float[Tensor, "3"]
) -> Float[Tensor, "4 4"]:
    """Return the rigid motion that is the exponential of a turn and a shift, which multiplies
    world-to-camera.
    """
    rows = torch.cat((cross_matrix(turn), shift[:, None]), 1)
    return torch.linalg.matrix_exp(F.pad(rows, (0, 0, 0, 1)))


def _moved(gaussians: Gaussians, motion: Float[Tensor, "4 4"]) -> Gaussians:
    """Move the scene instead of the camera: no rasterizer but `torch` has gradients for cameras.

    The value is exact at rest, where it is asked for; the gradient leaves out that a colour that
    depends on the side it is seen from turns with its Gaussian.
    """
    motion = motion.to(gaussians.means)
    w, x, y, z = matrices_to_quats(motion[:3, :3])
    rows = ((w, -x, -y, -z), (x, w, -z, y), (y, z, w, -x), (z, -y, x, w))
    product = torch.stack([torch.stack(row) for row in rows])
    means = gaussians.means @ motion[:3, :3].T + motion[:3, 3]
    return replace(gaussians, means=means, quats=gaussians.quats @ product.T)


def likeness_loss(
    shown: Picture, photo: Picture, perceptual: Loss, structure: bool = False
) -> Float[Tensor, ""]:
    """Return the protocol's loss: squared error and perceptual distance, for input cameras also 1 -
    structure.
    """
    value = F.mse_loss(shown, photo) + WEIGHT * perceptual(
        LossInputs(rendered=shown, target=photo)
    )
    if structure:
        value = value + (
            1 - structure_likeness(shown[0], photo[0]).clamp(max=STRUCTURE_ENOUGH)
        )
    return value


def structure_likeness(
    a: Float[Tensor, "n 3 height width"], b: Float[Tensor, "n 3 height width"]
) -> Float[Tensor, ""]:
    """Return the mean structure term of SSIM (Wang et al. 2004), in [-1, 1]: blind to brightness
    and contrast.
    """
    line = torch.exp(-((torch.arange(11) - 5.0) ** 2) / (2 * 1.5**2)).to(a)
    window = (line[:, None] * line / line.sum() ** 2).expand(3, 1, 11, 11)
    mean_a, mean_b, aa, bb, ab = (
        F.conv2d(x, window, groups=3) for x in (a, b, a * a, b * b, a * b)
    )
    spread = (
        (aa - mean_a**2).clamp(min=1e-8) * (bb - mean_b**2).clamp(min=1e-8)
    ).sqrt()
    constant = 0.03**2 / 2
    return ((ab - mean_a * mean_b + constant) / (spread + constant)).mean()


def pose_error(
    predicted: Float[np.ndarray, "4 4"], true: Float[np.ndarray, "4 4"]
) -> float:
    """Return the larger of the errors of rotation and of direction of two relative poses [degrees].

    A direction and its opposite count as one, as the protocol has it, so its error is at most 90
    degrees.
    """
    rotation, direction = pose_errors(predicted, true)
    return max(rotation, min(direction, 180 - direction))


def auc(errors: Sequence[float], limit: float) -> float:
    """Return the area under the curve of recall over error up to `limit`, over `limit`, in [0, 1];
    1 is best.

    The curve is drawn from (0, 0) through the sorted errors, straight between them (Sarlin et al.,
    SuperGlue, 2020); a failure is an infinite error.
    """
    x = np.concatenate([[0.0], np.sort(errors)])
    y = np.arange(len(x)) / max(len(errors), 1)
    inside = x < limit
    inside[0] = True
    x, y = np.append(x[inside], limit), np.append(y[inside], y[inside][-1])
    return float(np.trapezoid(y, x) / limit)


@torch.no_grad()
def measure_pair(
    reconstructor: Reconstructor,
    rasterizer: Rasterizer,
    perceptual: tuple[str, Loss],
    inputs: Sequence[Photo],
    targets: Sequence[Photo],
    steps: int,
) -> dict[str, float]:
    """Return the figures of one pair by name: means over the targets, at their true place and
    aligned, and poses.

    `perceptual` is the distance and what it is called; `steps` those of a target, an input camera
    takes twice as many. Raises MatchingError where the reconstructor finds no scene.
    """
    name, distance = perceptual
    reconstruction = reconstructor(views_of(inputs))
    true, predicted = (
        np.linalg.inv(inputs[0].c2w) @ inputs[-1].c2w,
        predicted_pose(reconstruction),
    )
    found = {"pose_error": [pose_error(predicted, true)]}

    def aligned(camera: Cameras, photo: Photo, steps: int, structure: bool) -> Cameras:
        compare = partial(likeness_loss, perceptual=distance, structure=structure)
        unit = float(np.linalg.norm(predicted[:3, 3]))
        return align(
            (reconstruction.gaussians, rasterizer),
            camera,
            _picture(photo),
            compare,
            steps,
            unit,
        )

    for target in targets:
        cameras = {"": target_camera(reconstruction, inputs[0], inputs[-1], target)}
        if steps:
            cameras["aligned_"] = aligned(cameras[""], target, steps, structure=False)
        for prefix, camera in cameras.items():
            shown, photo = (
                rasterizer.render(reconstruction.gaussians, camera).images.clamp(0, 1),
                _picture(target),
            )
            pictures = [x[0, 0].permute(1, 2, 0).numpy() for x in (shown, photo)]
            values = (
                psnr(*pictures),
                ssim(*pictures, gaussian=True),
                float(distance(LossInputs(shown, photo))),
            )
            for figure, value in zip(("psnr", "ssim", name), values):
                found.setdefault(prefix + figure, []).append(value)
    if steps:
        last = reconstruction.cameras.select([reconstruction.cameras.count - 1])
        refined = (
            aligned(last, inputs[-1], 2 * steps, structure=True)
            .c2w[0, 0]
            .double()
            .numpy()
        )
        found["refined_pose_error"] = [pose_error(refined, true)]
    return {figure: float(np.mean(values)) for figure, values in found.items()}


def _picture(photo: Photo) -> Picture:
    return torch.from_numpy(photo.image).permute(2, 0, 1)[None, None].contiguous()
