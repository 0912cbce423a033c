"""Where each photo's intrinsics come from: a camera file, else `--fov`, else EXIF, else a stated
default.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float64
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.lens import Lens
from edit3r.contract.reporting import say, warn
from edit3r.kit.geometry.cameras import from_pixels, intrinsics_from_fov
from edit3r.kit.photos.cameras import CAMERA_FILES, PosedCamera, read_cameras
from edit3r.kit.photos.decode import DecodedImage

DEFAULT_FOV = 60.0
"""Field of view across the longer side [degrees] when nothing is known: a 31 mm lens, between a
phone's main camera (about 67) and a standard lens (about 40).
"""

NO_CAMERAS = "none"
"""Said in the place of a camera file: none is looked for beside the photos either."""

SHAPE_TOLERANCE = (
    0.01  # relative difference of aspect ratios that rounding of scaled sizes explains
)


@dataclass(frozen=True)
class Intrinsics:
    """One photo's intrinsics, its pose where the same file knows it, and who said so."""

    normalised: Float64[Tensor, "3 3"]
    source: str
    c2w: Float64[Tensor, "4 4"] | None = None  # in the file's own frame and unit
    assumed: bool = False  # nobody knows them
    lens: Lens | None = None  # one that bends straight lines, to be straightened


def known_poses(found: Sequence[Intrinsics]) -> Float64[Tensor, "view 4 4"] | None:
    """The photos' poses where one file knows all of them: those of two files have no frame in
    common.
    """
    poses = [one.c2w for one in found if one.c2w is not None]
    complete = len(poses) == len(found) and len({one.source for one in found}) == 1
    return torch.stack(poses) if complete else None


class IntrinsicsFinder:
    """Looks up intrinsics photo by photo; camera files are read once."""

    def __init__(self, cameras: str | Path | None, fov: float | None) -> None:
        """`cameras`: a file to use, None to look beside each photo, NO_CAMERAS for neither. `fov`:
        horizontal [degrees].
        """
        self.fov = fov
        self.looks = str(cameras) != NO_CAMERAS
        given = None if cameras is None or not self.looks else Path(cameras)
        self.given = None if given is None else _CameraFile(given)
        self._found: dict[Path, _CameraFile | None] = {}

    def find(self, file: Path, image: DecodedImage) -> Intrinsics:
        """Intrinsics of the upright image `file`."""
        width, height = image.pixels.size
        size = (height, width)
        for camera_file in self._camera_files(file):
            camera = camera_file.find(file, by_name=camera_file is self.given)
            if (
                camera is not None
                and camera.K is not None
                and self._fits(camera, camera_file, file, size)
            ):
                c2w = None if camera.c2w is None else torch.from_numpy(camera.c2w)
                source = f"camera file {camera_file.path}"
                if camera_file is not self.given:
                    source += ", found beside the photos"
                    say(
                        "cameras.found",
                        f"the lens from {camera_file.path}, found beside the photos; "
                        f"--cameras {NO_CAMERAS} to ignore it",
                    )
                return Intrinsics(
                    torch.from_numpy(camera.intrinsics), source, c2w, lens=camera.lens
                )
        if self.fov is not None:
            return Intrinsics(_from_fov(self.fov, size), f"--fov {self.fov:g}")
        if image.focal is not None:
            return Intrinsics(_from_focal(image.focal, size), image.focal_source)
        focal = 0.5 * max(size) / math.tan(math.radians(DEFAULT_FOV) / 2)
        source = f"default ({DEFAULT_FOV:g} degrees across the longer side)"
        return Intrinsics(_from_focal(focal, size), source, assumed=True)

    def check_all_used(self, files: Sequence[Path]) -> None:
        """Raise InputError when a given camera file knows none of the photos; warn for those it
        does not know.
        """
        if self.given is None:
            return
        unknown = [
            file.name for file in files if self.given.find(file, by_name=True) is None
        ]
        if len(unknown) == len(files):
            raise InputError(
                f"{self.given.path}: has no camera for any of the photos (looked for {unknown[0]})."
            )
        if unknown:
            warn(f"{self.given.path}: has no camera for {', '.join(unknown)}.")

    def _camera_files(self, file: Path) -> Iterator["_CameraFile"]:
        if self.given is not None:
            yield self.given
            return
        for folder in (file.parent, file.parent.parent) if self.looks else ():
            for name in CAMERA_FILES:
                found = self._beside(folder / name)
                if found is not None:
                    yield found

    def _beside(self, path: Path) -> "_CameraFile | None":
        if path not in self._found:
            self._found[path] = None
            if path.is_file():
                try:
                    self._found[path] = _CameraFile(path)
                # found, not given: it may be another program's file of that name
                except InputError as error:
                    warn(f"{error} It is ignored.")
        return self._found[path]

    def _fits(
        self,
        camera: PosedCamera,
        camera_file: "_CameraFile",
        file: Path,
        size: tuple[int, int],
    ) -> bool:
        if abs(camera.width / camera.height * size[0] / size[1] - 1) <= SHAPE_TOLERANCE:
            return True
        problem = (
            f"{camera_file.path}: its camera for {file.name} is {camera.width}x{camera.height}, "
            "but the upright photo "
            f"is {size[1]}x{size[0]}."
        )
        if camera_file is self.given:
            raise InputError(problem)
        warn(f"{problem} It is ignored.")
        return False


class _CameraFile:
    """A camera file indexed by where its images lie and by what they are called."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._by_path: dict[Path, PosedCamera] = {}
        self._by_name: dict[str, PosedCamera | None] = {}
        for camera in read_cameras(path):
            self._by_path[(path.parent / camera.file).resolve()] = camera
            name = Path(camera.file).name
            self._by_name[name] = (
                None if name in self._by_name else camera
            )  # None: two images of that name

    def find(self, file: Path, by_name: bool) -> PosedCamera | None:
        camera = self._by_path.get(file.resolve())
        return self._by_name.get(file.name) if camera is None and by_name else camera


def _from_fov(fov: float, size: tuple[int, int]) -> Float64[Tensor, "3 3"]:
    return intrinsics_from_fov(math.radians(fov), size).double()


def _from_focal(focal: float, size: tuple[int, int]) -> Float64[Tensor, "3 3"]:
    height, width = size
    pixels = torch.tensor(
        [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64
    )
    return from_pixels(pixels, size)
