"""Photos in and images out: files and folders to `Views`, with a record of where every intrinsics
value came from.

Photos of one run may differ in size, shape and camera. Each is scaled to cover a common size and
cropped around its middle; intrinsics follow exactly.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from edit3r.contract.types import Views
from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write, sha256_of
from edit3r.io.coverage import (
    USUAL_FRAMES,
    VIDEO_SUFFIXES,
    choose_photos,
    origin,
    take_frames,
)
from edit3r.io.decode import decode, image_size, read_image
from edit3r.io.framing import Frame, Lens, common_size, frame_for
from edit3r.io.intrinsics import DEFAULT_FOV, Intrinsics, IntrinsicsFinder, known_poses
from edit3r.reporting import say, track, warn

__all__ = [
    "LoadedPhotos",
    "Photo",
    "Pixels",
    "encode_png",
    "evenly",
    "find_photos",
    "is_plain_name",
    "load_photos",
    "load_views",
    "packaged_pair",
    "read_image",
    "save_image",
    "save_pixels",
    "to_bytes",
    "unique_names",
]

Pixels = UInt8[np.ndarray, "height width 3"]

Item = TypeVar("Item")

SUFFIXES = (
    *(
        ".jpg",
        ".jpeg",
        ".jpe",
        ".jfif",
        ".mpo",
        ".png",
        ".webp",
        ".tif",
        ".tiff",
        ".heic",
        ".heif",
        ".avif",
    ),
    *(".bmp", ".ppm", ".pgm", ".jp2"),
)
"""Files taken from a folder; a file given by itself may be called anything."""

MOST_CHARACTERS, MOST_BYTES = (
    100,
    200,
)  # of a name from `unique_names`; file systems allow 255 bytes with the suffix
_UNSAFE = re.compile(
    r'[\x00-\x1f\x7f/\\:*?"<>|\ud800-\udfff]|\.\.+'
)  # surrogates: a file name that is no UTF-8
_RESERVED = re.compile(
    r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?|path_\d+", re.IGNORECASE
)  # Windows; frames of the video


@dataclass(frozen=True)
class Photo:
    """How one photo became one view."""

    name: str
    file: str
    sha256: str  # of the file
    size: tuple[int, int]  # (height, width) of the upright original [pixels]
    frame: Frame  # the part of it that is used, and its size as a view
    # such as "camera file cameras.json", "--fov 60", "EXIF 35 mm equivalent (26 mm)"
    intrinsics_source: str
    focal: tuple[float, float]  # fx, fy [pixels of the original]


@dataclass(frozen=True)
class LoadedPhotos:
    """Views (batch 1) and the record of each."""

    views: Views
    photos: tuple[Photo, ...]


def load_views(
    paths: str | Path | Sequence[str | Path],
    *,
    fov: float | None = None,
    cameras: str | Path | None = None,
    size: int | None = 512,
    names: Sequence[str] | None = None,
    most: int | None = None,
) -> Views:
    """The views of `load_photos`, without the record."""
    return load_photos(
        paths, fov=fov, cameras=cameras, size=size, names=names, most=most
    ).views


def load_photos(
    paths: str | Path | Sequence[str | Path],
    *,
    fov: float | None = None,
    cameras: str | Path | None = None,
    size: int | None = 512,
    names: Sequence[str] | None = None,
    most: int | None = None,
    read_lens: Callable[[Views], Lens | None] | None = None,
) -> LoadedPhotos:
    """Read photos, given as files and folders (a folder's images come in natural order).

    Intrinsics of each photo: from `cameras` (or a camera file that lies beside it), else `fov`
    (horizontal [degrees]), else EXIF, else a stated default. Poses come along where one camera file
    has them for all photos. `size` bounds the longer side [pixels]; None keeps the photos' own. At
    most `most` are used, those that cover the scene. Photos of one size whose lens nobody knows are
    straightened where `read_lens` tells from them that it bends straight lines. Raises InputError
    for anything that cannot be used, in one sentence that names the file.
    """
    _check_arguments(fov, size)
    files = choose_photos(find_photos(paths, max(USUAL_FRAMES, most or 0)), most)
    finder = IntrinsicsFinder(cameras, fov)
    finder.check_all_used(files)
    # Headers first, so that no more than one photo is ever in memory at full size.
    sizes = [image_size(file) for file in files]
    target = common_size(sizes, size)
    frames = [frame_for(photo_size, target) for photo_size in sizes]
    images, found = [], []
    for file, frame in track(list(zip(files, frames)), "read photos"):
        decoded = decode(file)
        found.append(finder.find(file, decoded))
        frames[len(images)] = frame = frame.through(found[-1].lens)
        images.append(_to_tensor(frame.cut(decoded.pixels)))
    names = _names(files, names)
    photos = tuple(map(_record, names, files, frames, found))
    assumed = tuple(i.assumed for i in found)
    _warn_of_losses(photos, assumed)
    intrinsics = torch.stack(
        [frame.follow(i.normalised) for frame, i in zip(frames, found)]
    )
    poses = known_poses(found)
    c2w = None if poses is None else poses[None].float()
    loaded = LoadedPhotos(
        Views(torch.stack(images)[None], intrinsics[None].float(), names, c2w, assumed),
        photos,
    )
    one_lens = len(set(sizes)) == 1 and all(assumed) and read_lens is not None
    return _straightened(loaded, files, read_lens(loaded.views)) if one_lens else loaded


def _straightened(
    loaded: LoadedPhotos, files: Sequence[Path], lens: Lens | None
) -> LoadedPhotos:
    """The photos as a plain pinhole would have taken them; as they are where `lens` is None."""
    if lens is None:
        return loaded
    say(
        "lens.straightened",
        f"it bends straight lines (k1 {lens.distortion[0]:.3f}); the photos are straightened",
    )
    photos = tuple(
        replace(photo, frame=photo.frame.through(lens)) for photo in loaded.photos
    )
    images = [
        _to_tensor(photo.frame.cut(decode(file).pixels))
        for photo, file in zip(photos, files)
    ]
    # One lens means photos of one size, of which the frames were all.
    intrinsics = (
        photos[0]
        .frame.follow(loaded.views.intrinsics[0, 0].double())
        .to(loaded.views.intrinsics)
    )
    views = replace(
        loaded.views,
        images=torch.stack(images)[None],
        intrinsics=intrinsics.expand(1, len(images), 3, 3),
    )
    return LoadedPhotos(views, photos)


def find_photos(
    paths: str | Path | Sequence[str | Path], frames: int = USUAL_FRAMES
) -> list[Path]:
    """The image files named by `paths`; each folder stands for its images in natural order (img2
    before img10), or for those of its `images` folder when it has none itself; a video for at most
    `frames` of its frames. Raises InputError when a path is not there.
    """
    paths = [paths] if isinstance(paths, (str, Path)) else list(paths)
    files: list[Path] = []
    for path in map(Path, paths):
        if path.is_dir():
            files += _images_in(path)
        elif path.suffix.lower() in VIDEO_SUFFIXES and path.is_file():
            files += take_frames(path, frames)
        elif path.exists():
            files.append(path)
        else:
            raise InputError(f"{path}: no such file or folder.")
    if not files:
        raise InputError(
            "No photos given: name two or more picture files, or a folder of them."
        )
    return files


def packaged_pair() -> tuple[list[str], Path]:
    """The real photo pair that scikit-image ships (Middlebury 2014, Motorcycle), and its published
    calibration.
    """
    import skimage

    folder = Path(skimage.__file__).parent / "data"
    photos = [str(folder / f"motorcycle_{side}.png") for side in ("left", "right")]
    return photos, Path(__file__).with_name("motorcycle_cameras.json")


def evenly(items: Sequence[Item], most: int | None) -> list[Item]:
    """At most `most` of the items, spread evenly from the first to the last; all of them for
    None.
    """
    if most is None or len(items) <= most:
        return list(items)
    return [
        items[index]
        for index in np.linspace(0, len(items) - 1, most).round().astype(int)
    ]


def unique_names(names: Sequence[str]) -> list[str]:
    """File names without suffix made from any texts, one for each: valid on every system, no two
    alike.

    A safe name that nobody else has is kept. Otherwise characters that a file system may refuse
    become "_", names that Windows or the frames of the video use get "_" in front, names above 100
    characters are cut, and equal names are numbered ("-1", "-2", ...). Names that differ only in
    case count as equal, as some file systems take them.
    """
    safe = [_safe_name(name) for name in names]
    count = Counter(map(_same_file, safe))
    taken = {name for name, times in count.items() if times == 1}
    result = []
    for name in safe:
        unique, number = name, 0
        while (number == 0 and count[_same_file(name)] > 1) or (
            number > 0 and _same_file(unique) in taken
        ):
            number += 1
            unique = f"{_cut(name, len(str(number)) + 1)}-{number}"
        taken.add(_same_file(unique))
        result.append(unique)
    return result


def is_plain_name(name: object) -> bool:
    """Whether a name from a file of strangers is the name of a file or folder, and no path that
    leads elsewhere.
    """
    return (
        isinstance(name, str)
        and 0 < len(name) <= 120
        and not _UNSAFE.search(name)
        and name.strip(". ") != ""
    )


def _safe_name(name: str) -> str:
    name = _UNSAFE.sub("_", name).strip(". ") or "photo"
    return _cut(f"_{name}" if _RESERVED.fullmatch(name) else name)


def _cut(name: str, room: int = 0) -> str:
    """The name without what is too long for a file name that ends with `room` more characters."""
    name = name[: MOST_CHARACTERS - room]
    while len(name.encode()) + room > MOST_BYTES:
        name = name[:-1]
    return name.rstrip(". ")


def _same_file(name: str) -> str:
    """Equal for two names that a file system may take for one."""
    return unicodedata.normalize("NFC", name).casefold()


def save_image(image: Float[Tensor, "3 height width"], path: str | Path) -> None:
    """Write an image as 8-bit PNG (by suffix also JPEG or WebP): clipped to [0, 1], times 255, to
    nearest, half to even. An image read at its own size comes back as the very same bytes per
    pixel.
    """
    if image.dim() != 3 or image.shape[0] != 3:
        raise ValueError(
            f"save_image: expected shape [3, height, width], got {list(image.shape)}"
        )
    if not torch.isfinite(image).all():
        raise ValueError(
            f"save_image: the picture for {path} holds values that are not finite"
        )
    save_pixels(to_bytes(image), path)


def save_pixels(pixels: Pixels, path: str | Path) -> None:
    """`save_image` for an image that is bytes already."""
    with atomic_write(path) as partial:
        if partial.suffix.lower() == ".png":
            partial.write_bytes(encode_png(pixels))
        else:
            Image.fromarray(pixels).save(partial, quality=95)  # of JPEG and WebP


def to_bytes(image: Float[Tensor, "3 height width"]) -> Pixels:
    """uint8 `[height, width, 3]` of an sRGB image, rounded as `save_image` states."""
    by_pixel = (
        image.detach()
        .to("cpu", torch.float32)
        .permute(1, 2, 0)
        .clone(memory_format=torch.contiguous_format)
    )
    return by_pixel.clamp_(0, 1).mul_(255).round_().to(torch.uint8).numpy()


def encode_png(pixels: Pixels) -> bytes:
    """The content of a PNG file; the same pixels give the same bytes.

    By OpenCV, whose filter and strategy (SUB, RLE) take half the time of Pillow's level 1.
    """
    good, content = cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
    if not good:
        raise ValueError(
            f"an image of shape {list(pixels.shape)} cannot be coded as PNG"
        )
    return content.tobytes()


def _to_tensor(image: Image.Image) -> Float[Tensor, "3 height width"]:
    return (
        torch.from_numpy(np.array(image, dtype=np.float32) / 255)
        .permute(2, 0, 1)
        .contiguous()
    )


def _check_arguments(fov: float | None, size: int | None) -> None:
    if fov is not None and not 0 < fov < 180:
        raise InputError(f"--fov: expected degrees above 0 and below 180, got {fov:g}.")
    if size is not None and size < 1:
        raise InputError(f"--size: expected at least 1 pixel, got {size}.")


def _images_in(folder: Path) -> list[Path]:
    for place in (folder, folder / "images"):
        if place.is_dir():
            found = [
                p
                for p in place.iterdir()
                if p.suffix.lower() in SUFFIXES and p.is_file()
            ]
            found = [
                p for p in found if not p.name.startswith(".")
            ]  # such as macOS's ._IMG_0001.jpg
            if found:
                return sorted(found, key=_natural)
    raise InputError(f"{folder}: no pictures in this folder.")


def _natural(path: Path) -> tuple:
    """Sort key in which digits count as numbers; the plain name decides between equals."""
    parts = re.split(r"(\d+)", path.name.casefold())
    return [
        (part.isdecimal(), int(part) if part.isdecimal() else part) for part in parts
    ], path.name


def _names(files: Sequence[Path], names: Sequence[str] | None) -> tuple[str, ...]:
    """The given names, or the files' own without suffix, each usable as a file name."""
    if names is not None and len(names) != len(files):
        raise InputError(
            f"names: expected one per photo ({len(files)}), got {len(names)}."
        )
    return tuple(
        unique_names([file.stem for file in files] if names is None else names)
    )


def _record(name: str, file: Path, frame: Frame, intrinsics: Intrinsics) -> Photo:
    height, width = frame.source
    focal = (
        float(intrinsics.normalised[0, 0]) * width,
        float(intrinsics.normalised[1, 1]) * height,
    )
    named = origin(file)
    return Photo(
        name, named, sha256_of(file), frame.source, frame, intrinsics.source, focal
    )


def _warn_of_losses(photos: Sequence[Photo], assumed: Sequence[bool]) -> None:
    guessed = [photo.name for photo, unknown in zip(photos, assumed) if unknown]
    if guessed:
        warn(
            f"No focal length is known for {', '.join(guessed)}: {DEFAULT_FOV:g} degrees across "
            "the longer side are "
            "assumed unless the photos themselves tell; --fov or --cameras tells better."
        )
    first: dict[str, str] = {}
    for photo in photos:
        height, width = photo.frame.target
        if photo.frame.cropped > 0.02:
            warn(
                f"{photo.file}: {photo.frame.cropped:.0%} is cropped away, so that all photos "
                f"are {width}x{height}."
            )
        if photo.frame.scale > 1.05:
            warn(
                f"{photo.file}: enlarged {photo.frame.scale:.1f} times, so that all photos are "
                f"{width}x{height}."
            )
        twin = first.setdefault(photo.sha256, photo.file)
        if twin != photo.file:
            warn(f"{twin} and {photo.file} are the same picture.")
