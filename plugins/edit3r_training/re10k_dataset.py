"""Dataset `re10k`: RealEstate10K, ACID or DL3DV as pixelSplat's `.torch` chunks.

A chunk is a list of scenes {key: str, cameras: [n, 18], images: n JPEG files as byte tensors}; a camera is normalised
fx, fy, cx, cy, two unused numbers and a row-major 3x4 world-to-camera matrix. Chunks are read without unpickling code.
"""

import io
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import torch
from PIL import Image, UnidentifiedImageError
from pydantic import Field
from torch import Tensor

from edit3r import config, reporting
from edit3r.errors import InputError
from edit3r.geometry.cameras import invert_rigid
from edit3r.interfaces import Dataset, SceneSample
from edit3r.io.framing import frame_for
from edit3r_training.photo_samples import make_sample
from edit3r_training.view_sampling import by_gap


class Re10kDataset(Dataset):
    """One sample is one draw of views from one scene; a scene that cannot be used is skipped and named once."""

    class Settings(config.Settings):
        root: str = Field(description="folder with .torch chunks")
        samples: int = Field(1, ge=1, description="draws per scene")
        seed: int = Field(0, ge=0, description="of view choice and mirroring")
        image_size: int = Field(256, ge=16, le=1024, description="side of the centred square [pixels]")
        context: int = Field(2, ge=2, le=16, description="input views")
        targets: int = Field(4, ge=0, le=16, description="novel views")
        gap: tuple[int, int] = Field((45, 90), description="from first to last context view [frames]")
        mirror: float = Field(0.5, ge=0, le=1, description="share of samples mirrored left to right")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._broken: set[str] = set()

    @cached_property
    def scenes(self) -> list[tuple[Path, int]]:
        """(chunk, place in it) of every scene; reading all chunks once is the price of knowing."""
        chunks = sorted(Path(self.settings.root).glob("*.torch"))
        found = []
        for chunk in chunks:
            try:
                found += [(chunk, place) for place in range(len(_read_chunk(chunk)))]
            except InputError as error:
                self._skip(chunk.name, str(error))
        if not found:
            raise InputError(f"{self.settings.root}: no readable .torch chunk with scenes in it.")
        return found

    def __len__(self) -> int:
        return len(self.scenes) * self.settings.samples

    def __getitem__(self, index: int) -> SceneSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        for attempt in range(len(self.scenes)):
            chunk, place = self.scenes[(index + attempt) % len(self.scenes)]
            try:
                return self._sample(_read_chunk(chunk)[place], index)
            except InputError as error:
                self._skip(f"{chunk.name}[{place}]", str(error))
        raise InputError(f"{self.settings.root}: none of its {len(self.scenes)} scenes can be used.")

    def _skip(self, name: str, reason: str) -> None:
        if name not in self._broken:
            self._broken.add(name)
            reporting.warn(f"dataset re10k: {name} is skipped ({len(self._broken)} so far): {reason}")

    def _sample(self, scene: dict, index: int) -> SceneSample:
        cameras, files, key = _checked(scene)
        rng = np.random.default_rng((self.settings.seed, index))
        choice = by_gap(rng, len(files), self.settings.context, self.settings.targets, self.settings.gap)
        if choice is None:
            raise InputError(f"scene {key} has {len(files)} frames, too few for {self.settings.context} context views.")
        views = [*choice.context, *choice.target]
        pictures, intrinsics = zip(*(_square(files[v], cameras[v], self.settings.image_size, key) for v in views))
        return make_sample(
            torch.stack(pictures),
            _c2w(cameras[views]),
            torch.stack(intrinsics),
            self.settings.context,
            f"{key}-{index}",
            rng,
            self.settings.mirror,
        )


@lru_cache(maxsize=2)
def _read_chunk(path: Path) -> list:
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise InputError(f"{path}: not a readable chunk ({str(error).splitlines()[0]}).") from None
    if not isinstance(content, list):
        raise InputError(f"{path}: expected a list of scenes, got {type(content).__name__}.")
    return content


def _checked(scene: dict) -> tuple[Tensor, list, str]:
    """Cameras, JPEG files and key; InputError when they are not what the layout promises."""
    missing = [name for name in ("key", "cameras", "images") if name not in scene]
    if missing:
        raise InputError(f"a scene without {missing[0]!r}.")
    cameras, files, key = scene["cameras"], scene["images"], str(scene["key"])
    if cameras.ndim != 2 or cameras.shape[1] != 18 or len(files) != len(cameras):
        raise InputError(
            f"scene {key}: expected cameras [n, 18] for its {len(files)} images, got {list(cameras.shape)}."
        )
    if not cameras.isfinite().all():
        raise InputError(f"scene {key}: its cameras are not finite.")
    return cameras, files, key


def _c2w(cameras: Tensor) -> Tensor:
    w2c = torch.eye(4, dtype=torch.float64).repeat(len(cameras), 1, 1)
    w2c[:, :3] = cameras[:, 6:].double().reshape(-1, 3, 4)
    return invert_rigid(w2c)


def _square(file: Tensor, camera: Tensor, size: int, key: str) -> tuple[Tensor, Tensor]:
    """The centred square of one frame and its intrinsics."""
    try:
        picture = Image.open(io.BytesIO(file.numpy().tobytes())).convert("RGB")
    except (UnidentifiedImageError, OSError) as error:
        raise InputError(f"scene {key}: a frame is no picture ({error}).") from None
    frame = frame_for((picture.height, picture.width), (size, size))
    fx, fy, cx, cy = camera[:4].tolist()
    intrinsics = frame.follow(torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64)).float()
    return torch.from_numpy(np.asarray(frame.cut(picture), np.float32) / 255).permute(2, 0, 1), intrinsics
