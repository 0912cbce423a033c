"""Dataset `re10k`: RealEstate10K, ACID or DL3DV as pixelSplat's `.torch` chunks.

A chunk is a list of scenes {key: str, cameras: [n, 18], images: n JPEG files as byte tensors}; a
camera is normalised fx, fy, cx, cy, two unused numbers and a row-major 3x4 world-to-camera matrix.
Chunks are read without unpickling code.
"""

import io
from collections.abc import Sequence
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.kit.geometry.cameras import invert_rigid
from edit3r.kit.photos.decode import FORMATS
from edit3r.kit.photos.framing import frame_for
from edit3r.kit.photos.posed_folder import PosedPhoto
from edit3r_training.photo_dataset import (
    DrawnPhotos,
    PhotoDataset,
    PhotoSettings,
    choose_by_gap,
)


class Re10kDataset(PhotoDataset):
    """Scenes of `.torch` chunks."""

    name = "re10k"

    class Settings(PhotoSettings):
        root: str
        """folder with .torch chunks"""

    settings: Settings

    @cached_property
    def scenes(self) -> list[tuple[Path, int]]:
        """(chunk, index in it) of every scene; reading all chunks once is the price of knowing."""
        scenes_found = []
        for chunk in sorted(Path(self.settings.root).glob("*.torch")):
            try:
                scenes_found += [
                    (chunk, place) for place in range(len(_read_chunk(chunk)))
                ]
            except InputError as error:
                self._skip(chunk.name, str(error))
        if not scenes_found:
            raise InputError(
                f"{self.settings.root}: no readable .torch chunk with scenes in it."
            )
        return scenes_found

    @cached_property
    def places(self) -> dict[str, tuple[Path, int]]:
        """Chunk and index in it of every scene, by key."""
        return {
            str(_read_chunk(chunk)[place].get("key")): (chunk, place)
            for chunk, place in self.scenes
        }

    def photos(self, key: str, indices: Sequence[int]) -> list[PosedPhoto]:
        """Frames of one scene, by an index file. Raises InputError for what is not there."""
        if key not in self.places:
            raise InputError(f"{self.settings.root}: no chunk has the scene {key!r}.")
        chunk, place = self.places[key]
        scene = _checked(_read_chunk(chunk)[place])
        count = len(scene["images"])
        if max(indices) >= count:
            raise InputError(
                f"scene {key}: frame {max(indices)} was asked for, but it has {count} frames, "
                "counted from 0."
            )
        return self._frames(scene, indices)

    def _label(self, scene: tuple[Path, int]) -> str:
        return f"{scene[0].name}[{scene[1]}]"

    def _draw(
        self, scene: tuple[Path, int], rng: np.random.Generator, gap: tuple[int, int]
    ) -> DrawnPhotos:
        chosen, (chunk, place) = self.settings, scene
        content = _checked(_read_chunk(chunk)[place])
        count = len(content["images"])
        views = choose_by_gap(rng, count, chosen.context, chosen.targets, gap)
        if views is None:
            raise InputError(
                f"scene {content['key']} has {count} frames, too few for {chosen.context} context "
                "views."
            )
        return DrawnPhotos.of(content["key"], self._frames(content, views))

    def _frames(self, scene: dict, views: Sequence[int]) -> list[PosedPhoto]:
        """Some frames of a checked scene."""
        cameras = scene["cameras"]
        files = scene["images"]
        size = self.settings.image_size
        return [_square(files[v], cameras[v], size, scene["key"]) for v in views]


@lru_cache(maxsize=2)
def _read_chunk(path: Path) -> list:
    """The scenes of a chunk, read without unpickling code."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise InputError(
            f"{path}: not a readable chunk ({str(error).splitlines()[0]})."
        ) from None
    if not isinstance(content, list):
        raise InputError(
            f"{path}: expected a list of scenes, got {type(content).__name__}."
        )
    return content


def _checked(scene: dict) -> dict:
    """The scene, its key as text; InputError when it is not what the layout promises."""
    missing = [name for name in ("key", "cameras", "images") if name not in scene]
    if missing:
        raise InputError(f"a scene without {missing[0]!r}.")
    cameras, files, key = scene["cameras"], scene["images"], str(scene["key"])
    if cameras.ndim != 2 or cameras.shape[1] != 18 or len(files) != len(cameras):
        raise InputError(
            f"scene {key}: expected cameras [n, 18] for its {len(files)} images, got "
            f"{list(cameras.shape)}."
        )
    if not cameras.isfinite().all():
        raise InputError(f"scene {key}: its cameras are not finite.")
    return {**scene, "key": key}


def _square(
    file: UInt8[Tensor, " byte"], camera: Float[Tensor, "18"], size: int, key: str
) -> PosedPhoto:
    """The centred square of one frame, with its camera."""
    try:
        content = io.BytesIO(file.numpy().tobytes())
        image = Image.open(content, formats=FORMATS).convert("RGB")
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"scene {key}: a frame is not an image ({error}).") from None
    frame = frame_for((image.height, image.width), (size, size))
    fx, fy, cx, cy = camera[:4].tolist()
    k = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64)
    # The file has row-major 3x4 world-to-camera matrices.
    w2c = torch.eye(4, dtype=torch.float64)
    w2c[:3] = camera[6:].double().reshape(3, 4)
    square = np.asarray(frame.cut(image), np.float32) / 255
    return PosedPhoto(square, frame.follow(k).numpy(), invert_rigid(w2c).numpy())
