"""NoPoSplat's evaluation of reconstruction (Ye et al., ICLR 2025): index files, aligned cameras,
AUC of poses.

An index file is JSON as of pixelSplat: {scene: {"context": [a, b], "target": [...], "overlap": 0.4}
or null}, numbers of frames; a list of such entries gives a scene several pairs.

A scene from two photos without poses stands in a frame and a unit of length of its own, so a true
camera stands a little beside the place that its photo shows. The protocol moves it there, the scene
frozen, before it compares.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import fmean

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.filters import gaussian_blur2d
from pydantic import Field, NonNegativeInt
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Dataset, Loss, LossInputs, Rasterizer
from edit3r.contract.settings import Settings, make_settings
from edit3r.contract.types import Cameras
from edit3r.kit.command.results import read_json
from edit3r.kit.compute.metrics import psnr, ssim
from edit3r.kit.geometry.rotations import cross_matrix
from edit3r.kit.photos.posed_folder import PosedPhoto, read_posed_folder
from edit3r.kit.photos.triples import Pose
from edit3r.kit.reconstructing import WithMatcher
from edit3r_measure.novel_view import PredictedScene, pose_errors, views_of
from edit3r_measure.scene_sources import EvaluationScene, SceneSource

# The numbers of this block: as published.
# step of Adam, of a turn [radians] and of a shift [distances between the input cameras]
RATE = 0.005
# of the perceptual distance beside the mean squared error, as in the training of NoPoSplat
WEIGHT = 0.05
STRUCTURE_ENOUGH = 0.98  # likeness of structure from which more of it is not asked for

AUC_DEGREES = (5, 10, 20)
# Overlap of two photos, as NoPoSplat's tables are divided; what is in none of them is left out
# there; as published
CLASSES = {"small": (0.05, 0.3), "medium": (0.3, 0.55), "large": (0.55, 0.8)}
NOT_CLASSED = "not classed"
Images = Float[Tensor, "n 3 height width"]
BatchedImage = Float[Tensor, "1 1 3 height width"]
Compare = Callable[[BatchedImage, BatchedImage], Float[Tensor, ""]]


class IndexEntry(Settings, extra="ignore"):
    """One pair of an index file."""

    context: tuple[NonNegativeInt, ...] = Field(min_length=2)  # frames that are given
    target: tuple[NonNegativeInt, ...] | NonNegativeInt  # frames that are predicted
    # share of one photo that the other shows, or a class
    overlap: float | str | None = None

    @property
    def targets(self) -> tuple[int, ...]:
        return (self.target,) if isinstance(self.target, int) else self.target

    @property
    def overlap_class(self) -> str:
        """Key of CLASSES; NOT_CLASSED for other overlaps and where none is told (published: -1)."""
        for name, (low, high) in CLASSES.items():
            if self.overlap == name:
                return name
            if isinstance(self.overlap, float) and low <= self.overlap <= high:
                return name
        return NOT_CLASSED


class _IndexFile(Settings):
    pairs: dict[str, IndexEntry | list[IndexEntry | None] | None]


def read_index(path: Path) -> list[tuple[str, IndexEntry]]:
    """Scenes and pairs of an index file but null ones. Raises an error that names the scene."""
    if not path.is_file():
        raise InputError(
            f"{path}: no such index file; benchmarks/poses.py index makes one."
        )
    index = make_settings(_IndexFile, {"pairs": read_json(path)}, where=path.name)
    pairs = []
    for scene, own in index.pairs.items():
        entries = own if isinstance(own, list) else [own]
        pairs += [(scene, entry) for entry in entries if entry is not None]
    return pairs


def index_scenes(
    index: Sequence[tuple[str, IndexEntry]], places: Sequence[str | Dataset], size: int
) -> list[SceneSource]:
    """Return the pairs of an index as scenes; their photos are those of `places`."""
    return [
        SceneSource(name, partial(_index_scene, name, entry, places, size))
        for name, entry in index
    ]


def _index_scene(
    name: str, entry: IndexEntry, places: Sequence[str | Dataset], size: int
) -> EvaluationScene:
    frames = (*entry.context, *entry.targets)
    photos = photos_of(places, name, frames, size)
    count = len(entry.context)
    return EvaluationScene(
        source=name,
        kind="protocol",
        files=tuple(map(str, frames)),
        inputs=tuple(photos[:count]),
        targets=tuple(photos[count:]),
        overlap=entry.overlap_class,
    )


def photos_of(
    places: Sequence[str | Dataset], scene: str, indices: Sequence[int], size: int
) -> list[PosedPhoto]:
    """Frames of a scene: of a folder of its name, or one inside, or of a data set."""
    for place in places:
        if isinstance(place, Dataset):
            if not hasattr(place, "photos"):
                raise InputError(
                    f"{type(place).__name__} has no scenes by name, as re10k has; give folders "
                    "of photos."
                )
            return place.photos(scene, indices)
        for path in (Path(place), Path(place) / scene):
            if path.resolve().name == scene and path.is_dir():
                folder = read_posed_folder(path)
                count = len(folder.cameras)
                if max(indices) >= count:
                    raise InputError(
                        f"{path}: the index asks for frame {max(indices)}, it has {count} photos "
                        "with known cameras."
                    )
                return [folder.load(index, size) for index in indices]
    raise InputError(
        f"{scene}: none of the given folders is or holds this scene of the index."
    )


def align(
    scene: PredictedScene,
    camera: Cameras,
    photo: BatchedImage,
    compare: Compare,
    steps: int,
    rate: float = RATE,
) -> Cameras:
    """Return `camera` (one, batch 1) moved to where the frozen scene looks most like `photo`, by
    `steps` of Adam, each about `rate` long [radians and distances of the pair].

    Of all places on the way the best is returned, so it is never worse than the first by `compare`
    (the published code takes the last).
    """
    unit = float(np.linalg.norm(scene.predicted_pose[:3, 3]))
    units = torch.tensor([1.0, 1.0, 1.0, unit, unit, unit], dtype=torch.float64)
    twist = torch.zeros_like(units, requires_grad=True)  # a turn, then a shift
    adam = torch.optim.Adam([twist], lr=rate)
    c2w = camera.c2w[0, 0].double()
    places = []
    for _ in range(steps + 1):
        with torch.enable_grad():
            pose = (c2w @ _motion(twist * units))[None, None].to(camera.c2w)
            here = replace(camera, c2w=pose)
            shown = scene.rasterizer.render(scene.reconstruction.gaussians, here)
            value = compare(shown.images, photo)
            adam.zero_grad()
            value.backward()
        places.append((value.item(), replace(camera, c2w=pose.detach())))
        adam.step()
        with torch.no_grad():
            # The camera takes the step, and the next one begins at zero.
            c2w = c2w @ _motion(twist * units)
            twist.zero_()
    return min(places, key=lambda place: place[0])[1]


def _motion(twist: Float[Tensor, "6"]) -> Float[Tensor, "4 4"]:
    """Return the rigid motion that is the exponential of a turn and a shift."""
    rows = torch.cat((cross_matrix(twist[:3]), twist[3:, None]), 1)
    return torch.linalg.matrix_exp(F.pad(rows, (0, 0, 0, 1)))


def likeness_loss(
    shown: BatchedImage, photo: BatchedImage, perceptual: Loss, structure: bool = False
) -> Float[Tensor, ""]:
    """Squared error and perceptual distance, for input cameras also 1 - structure."""
    distance = perceptual(LossInputs(rendered=shown, target=photo))
    value = F.mse_loss(shown, photo) + WEIGHT * distance
    if structure:
        likeness = structure_likeness(shown[0], photo[0])
        value = value + 1 - likeness.clamp(max=STRUCTURE_ENOUGH)
    return value


def structure_likeness(a: Images, b: Images) -> Float[Tensor, ""]:
    """Mean structure term of SSIM (Wang et al. 2004), in [-1, 1]: blind to light and contrast."""

    def mean(images: Images) -> Images:
        """In Gaussian windows that lie within the image."""
        return gaussian_blur2d(images, (11, 11), (1.5, 1.5))[..., 5:-5, 5:-5]

    covariance = mean(a * b) - mean(a) * mean(b)
    variance_a = (mean(a * a) - mean(a) ** 2).clamp(min=1e-8)
    variance_b = (mean(b * b) - mean(b) ** 2).clamp(min=1e-8)
    constant = 0.03**2 / 2
    spread = (variance_a * variance_b).sqrt()
    return ((covariance + constant) / (spread + constant)).mean()


def pose_error(predicted: Pose, true: Pose) -> float:
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
    inside = sorted(error for error in errors if error < limit)
    x = [0.0, *inside, limit]
    counts = [*range(len(inside) + 1), len(inside)]
    return float(np.trapezoid(counts, x)) / (limit * max(len(errors), 1))


@dataclass(frozen=True)
class PairProtocol:
    """Measures one pair of an index; means over its targets."""

    reconstructor: WithMatcher
    rasterizer: Rasterizer
    distance: str  # name of the loss, and of its figures
    loss: Loss
    # that align a target with its photo; an input camera takes twice as many
    steps: int

    @torch.no_grad()
    def __call__(self, scene: EvaluationScene) -> dict[str, float]:
        """Return the figures by name. Raises MatchingError where no scene is found."""
        reconstruction = self.reconstructor(views_of(scene.inputs))
        predicted = PredictedScene(reconstruction, self.rasterizer, scene.inputs)
        targets = [self._figures(predicted, target) for target in scene.targets]
        figures = {name: fmean(own[name] for own in targets) for name in targets[0]}
        true = predicted.true_pose
        figures["pose_error"] = pose_error(predicted.predicted_pose, true)
        if self.steps:
            camera = predicted.cameras.select([predicted.cameras.count - 1])
            compare = partial(likeness_loss, perceptual=self.loss, structure=True)
            photo = _batched(scene.inputs[-1].image)
            refined = align(predicted, camera, photo, compare, 2 * self.steps)
            pose = refined.c2w[0, 0].double().numpy()
            figures["refined_pose_error"] = pose_error(pose, true)
        return figures

    def _figures(
        self, predicted: PredictedScene, target: PosedPhoto
    ) -> dict[str, float]:
        """Compare a target at its true place and, after it was aligned, at its own."""
        cameras = {"": predicted.camera_of(target)}
        photo = _batched(target.image)
        if self.steps:
            compare = partial(likeness_loss, perceptual=self.loss)
            aligned = align(predicted, cameras[""], photo, compare, self.steps)
            cameras["aligned_"] = aligned
        figures = {}
        for prefix, camera in cameras.items():
            shown = predicted.show(camera).image
            distance = self.loss(LossInputs(rendered=_batched(shown), target=photo))
            figures[f"{prefix}psnr"] = psnr(shown, target.image)
            figures[f"{prefix}ssim"] = ssim(shown, target.image, gaussian=True)
            figures[prefix + self.distance] = float(distance)
        return figures


def _batched(image: Float[np.ndarray, "height width 3"]) -> BatchedImage:
    return torch.from_numpy(image).permute(2, 0, 1)[None, None].contiguous()
