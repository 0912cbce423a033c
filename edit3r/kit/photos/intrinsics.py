"""Where a photo's intrinsics come from: a camera file, else `--fov`, EXIF, a stated default."""

import math
import re
import unicodedata
from collections import defaultdict
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
from edit3r.kit.photos.camera_entries import CameraEntry, PosedCamera, Size
from edit3r.kit.photos.camera_files import SPLITS, camera_entries, camera_files_in
from edit3r.kit.photos.decode import ImageHeader

DEFAULT_FOV = 60.0
"""Field of view across the longer side [degrees] when nothing is known: a 31 mm lens, between a
phone's main camera (about 67) and a standard lens (about 40). No figure kept.
"""

NO_CAMERAS = "none"
"""Said in the place of a camera file: none is looked for beside the photos either."""

# relative difference of aspect ratios that rounding of scaled sizes explains; a sanity limit
SHAPE_TOLERANCE = 0.01


@dataclass(frozen=True)
class Intrinsics:
    """One photo's intrinsics, its pose where the same file knows it, and who said so."""

    normalised: Float64[Tensor, "3 3"]
    source: str
    c2w: Float64[Tensor, "4 4"] | None = None  # in the file's own frame and unit
    frame: str = ""  # equal for poses in one frame and unit; empty: `source`
    assumed: bool = False  # nobody knows them
    lens: Lens | None = None  # one that bends straight lines, to be straightened
    mask: Path | None = None  # of the photo, as its camera file says


def known_poses(intrinsics: Sequence[Intrinsics]) -> Float64[Tensor, "view 4 4"] | None:
    """The photos' poses where one file knows all of them: those of two files have no frame in
    common, but for the parts of a data set.
    """
    poses = [one.c2w for one in intrinsics if one.c2w is not None]
    complete = (
        len(poses) == len(intrinsics)
        and len({one.frame or one.source for one in intrinsics}) == 1
    )
    return torch.stack(poses) if complete else None


def as_others_of_its_size(
    intrinsics: Sequence[Intrinsics], sizes: Sequence[Size], index: int
) -> Intrinsics:
    """A photo's intrinsics; where nobody knows them, those of other photos of its size if they
    agree: one camera took them.
    """
    of_photo = intrinsics[index]
    alike = [one for one, size in zip(intrinsics, sizes) if size == sizes[index]]
    known = [one for one in alike if not one.assumed]
    if not of_photo.assumed or not known:
        return of_photo
    first, *others = known
    for other in others:
        off = (other.normalised / first.normalised - 1).diagonal().abs().max()
        if off > SHAPE_TOLERANCE or other.lens != first.lens:
            return of_photo
    source = f"{first.source}, of other photos of its size"
    return Intrinsics(first.normalised, source, lens=first.lens)


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
        self._files_in: dict[Path, list[Path]] = {}
        self._found: dict[Path, _CameraFile | None] = {}

    def find(self, file: Path, image: ImageHeader) -> Intrinsics:
        """Intrinsics of the upright image `file`."""
        size = image.size
        for camera_file in self._camera_files(file):
            camera = self._camera(camera_file, file, size)
            if camera is not None:
                source = f"camera file {camera_file.path}"
                if camera_file is not self.given:
                    source += ", found beside the photos"
                    say(
                        "cameras.found",
                        f"the lens from {camera_file.path}, found beside the photos; "
                        f"--cameras {NO_CAMERAS} to ignore it",
                    )
                return Intrinsics(
                    torch.from_numpy(camera.intrinsics),
                    source,
                    None if camera.c2w is None else torch.from_numpy(camera.c2w),
                    camera_file.frame,
                    lens=camera.lens,
                    mask=camera_file.folder / camera.mask if camera.mask else None,
                )
        if self.fov is not None:
            lens = intrinsics_from_fov(math.radians(self.fov), size).double()
            return Intrinsics(lens, f"--fov {self.fov:g}")
        if image.focal is not None:
            return Intrinsics(_from_focal(image.focal, size), image.focal_source)
        focal = 0.5 * max(size) / math.tan(math.radians(DEFAULT_FOV) / 2)
        source = f"default ({DEFAULT_FOV:g} degrees across the longer side)"
        return Intrinsics(_from_focal(focal, size), source, assumed=True)

    def check_all_used(self, files: Sequence[Path]) -> None:
        """Raise InputError when a given camera file knows none of the photos; warn of some."""
        if self.given is None:
            return
        unknown = [file.name for file in files if not self.given.entries_of(file, True)]
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
            if folder not in self._files_in:
                self._files_in[folder] = camera_files_in(folder)
            for path in self._files_in[folder]:
                camera_file = self._beside(path)
                if camera_file is not None:
                    yield camera_file

    def _beside(self, path: Path) -> "_CameraFile | None":
        if path not in self._found:
            self._found[path] = None
            try:
                self._found[path] = _CameraFile(path)
            # found, not given: it may be another program's file of that name
            except InputError as error:
                warn(f"{error} It is ignored.")
        return self._found[path]

    def _camera(
        self, camera_file: "_CameraFile", file: Path, size: tuple[int, int]
    ) -> PosedCamera | None:
        """A photo's camera with intrinsics; a fault in a file that was not given is a warning."""
        height, width = size
        try:
            camera = camera_file.find(file, camera_file is self.given, (width, height))
            if camera is None or camera.K is None:
                return None
            shape = camera.width / camera.height
            if abs(shape * height / width - 1) > SHAPE_TOLERANCE:
                raise InputError(
                    f"{camera_file.path}: its camera for {file.name} is {camera.width}x"
                    f"{camera.height}, but the upright photo is {width}x{height}."
                )
            return camera
        except InputError as error:
            if camera_file is self.given:
                raise
            warn(f"{error} It is ignored.")
            return None


class _CameraFile:
    """A camera file indexed by what its images are called."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.folder = path if path.is_dir() else path.parent
        self.frame = str(self.folder if path.name in SPLITS else path)
        self._entries: dict[str, list[CameraEntry]] = defaultdict(list)
        self._by_stem: dict[str, list[CameraEntry]] = defaultdict(list)
        for entry in camera_entries(path):
            self._entries[_key(entry.file)].append(entry)
            self._by_stem[_key(str(Path(entry.file).with_suffix("")))].append(entry)

    def find(self, file: Path, given: bool, size: Size) -> PosedCamera | None:
        """The photo's camera; None where the file has none, or none that is certain.

        Raises InputError for two cameras of one image that differ.
        """
        entries = self.entries_of(file, given)
        files = sorted({entry.file for entry in entries})
        if len(files) > 1 and given:
            raise InputError(
                f"{self.path}: {file.name} may be {files[0]} or {files[1]} in it; give photos "
                "whose folders say which, or a camera file that names each once."
            )
        if len(files) != 1:
            return None
        first, *others = (entry.camera(size) for entry in entries)
        if any(not first.says_the_same_as(other) for other in others):
            raise InputError(
                f"{self.path}: names {first.file} {len(entries)} times, with cameras that differ."
            )
        return first

    def entries_of(self, file: Path, given: bool) -> list[CameraEntry]:
        """What may speak of a photo, by where it lies, else by what it is called.

        Names alone count where the file was given by the user, or where no image lies at the place
        that it states: it may have been made elsewhere.
        """
        named = self._named(file.name) or self._named(file.stem)
        named = named or self._saved_anew(file)
        place = file.resolve()
        here = [one for one in named if (self.folder / one.file).resolve() == place]
        if here:
            return here
        loose = [one for one in named if given or self._is_moved(one, file)]
        parts = place.parts
        for ends_alike in (
            lambda one: parts[-len(Path(one).parts) :] == Path(one).parts,
            lambda one: Path(one).name == file.name,
        ):
            better = [one for one in loose if ends_alike(one.file)]
            loose = better or loose
        return loose

    def _named(self, name: str) -> list[CameraEntry]:
        return self._entries.get(_key(name), [])

    def _saved_anew(self, file: Path) -> list[CameraEntry]:
        """What speaks of a photo of that name in another format, where it is gone."""
        alike = self._by_stem.get(_key(file.stem), [])
        return [one for one in alike if not (self.folder / one.file).is_file()]

    def _is_moved(self, entry: CameraEntry, file: Path) -> bool:
        listed = self.folder / entry.file
        smaller = re.fullmatch(
            re.escape(listed.parent.name) + r"_\d+", file.parent.name
        )
        return not listed.is_file() or smaller is not None


def _key(name: str) -> str:
    """Equal for two names that some system takes for one: by case, or how accents are written."""
    return unicodedata.normalize("NFC", name.rpartition("/")[2]).casefold()


def _from_focal(focal: float, size: tuple[int, int]) -> Float64[Tensor, "3 3"]:
    height, width = size
    pixels = torch.tensor(
        [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64
    )
    return from_pixels(pixels, size)
