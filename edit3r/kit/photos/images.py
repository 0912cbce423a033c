"""Photos in and images out: files and folders to `Views`, with a record of each photo.

Photos of one run may differ in size, shape and camera. Each is scaled to cover a common size and
cropped around its middle; intrinsics follow exactly.
"""

import glob
import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import ExifTags, Image
from PIL.PngImagePlugin import PngInfo
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.lens import Lens
from edit3r.contract.reporting import say, track, warn
from edit3r.contract.torch_state import in_usual_torch
from edit3r.contract.types import Views
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.files.names import natural, refuse_elsewhere, unique_names
from edit3r.kit.photos.coverage import (
    USUAL_FRAMES,
    VIDEO_SUFFIXES,
    choose_photos,
    take_frames,
)
from edit3r.kit.photos.decode import (
    DEVELOP,
    RAW_SUFFIXES,
    SUFFIXES,
    decode,
    read_header,
    read_image,
)
from edit3r.kit.photos.framing import Frame, common_size, frame_for
from edit3r.kit.photos.intrinsics import (
    Intrinsics,
    IntrinsicsFinder,
    as_others_of_its_size,
    known_poses,
)
from edit3r.kit.photos.only_photos import MADE_HERE, only_photos
from edit3r.kit.photos.temporary import (
    Pictures,
    as_files,
    origin,
    temporary_photos,
)

__all__ = [
    "SUFFIXES",
    "LoadedPhotos",
    "Photo",
    "Pixels",
    "encode_png",
    "evenly",
    "expand",
    "find_photos",
    "images_of_folder",
    "load_photos",
    "load_views",
    "packaged_pair",
    "read_image",
    "save_image",
    "save_pixels",
    "to_bytes",
]

Pixels = UInt8[np.ndarray, "height width 3"]
Item = TypeVar("Item")

ENOUGH = 2  # pixels of a photo for each of its view, of which averages are exact enough
NARROWEST = 20  # long by short side of what can be a photo
MOST_LOOKED_AT = 1000  # places for photos in the folders of an empty one


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
    mask: str | None = None  # file of its mask, where its camera file names one


@dataclass(frozen=True)
class LoadedPhotos:
    """Views (batch 1) and the record of each."""

    views: Views
    photos: tuple[Photo, ...]


def load_views(
    paths: Pictures,
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


@in_usual_torch
@temporary_photos()
def load_photos(
    paths: Pictures,
    *,
    fov: float | None = None,
    cameras: str | Path | None = None,
    size: int | None = 512,
    names: Sequence[str] | None = None,
    most: int | None = None,
) -> LoadedPhotos:
    """Read photos, given as files and folders (a folder's images come in natural order), or as
    arrays, tensors and PIL images.

    Intrinsics of each photo: from `cameras` (or a camera file that lies beside it), else `fov`
    (horizontal [degrees]), else EXIF, else a stated default. Poses come along where one camera file
    has them for all photos. `size` bounds the longer side [pixels]; None keeps the photos' own. At
    most `most` are used, those that cover the scene. Raises InputError for anything that cannot be
    used, in one sentence that names the file.
    """
    _check_arguments(fov, size)
    files = choose_photos(find_photos(paths, max(USUAL_FRAMES, most or 0)), most)
    return read_photos(files, fov=fov, cameras=cameras, size=size, names=names)


def read_photos(
    files: Sequence[Path],
    *,
    fov: float | None = None,
    cameras: str | Path | None = None,
    size: int | None = 512,
    names: Sequence[str] | None = None,
    read_lens: Callable[[Views], Lens | None] | None = None,
) -> LoadedPhotos:
    """`load_photos` of files that were found and chosen. Photos of one size whose lens nobody knows
    are straightened where `read_lens` tells from them that it bends straight lines.
    """
    finder = IntrinsicsFinder(cameras, fov)
    finder.check_all_used(files)
    names = _names(files, names)
    # Headers first, so that no more than one photo is ever in memory at full size.
    headers = [read_header(file) for file in files]
    for remark in (remark for header in headers for remark in header.remarks):
        warn(remark)
    sizes = [header.size for header in headers]
    _check_shapes(files, sizes)
    target = common_size(sizes, size)
    known_lenses = [finder.find(*pair) for pair in zip(files, headers)]
    known_lenses = [
        as_others_of_its_size(known_lenses, sizes, view) for view in range(len(files))
    ]
    images, photos = [], []
    for name, file, header, known in track(
        list(zip(names, files, headers, known_lenses)), "read photos"
    ):
        image, photo = _as_view(name, file, header.size, known, target)
        images.append(image)
        photos.append(photo)
    assumed = tuple(intrinsics.assumed for intrinsics in known_lenses)
    _warn_of_losses(photos)
    normalised = [
        photo.frame.follow(intrinsics.normalised)
        for photo, intrinsics in zip(photos, known_lenses)
    ]
    poses = known_poses(known_lenses)
    views = Views(
        images=torch.stack(images)[None],
        intrinsics=torch.stack(normalised)[None].float(),
        names=names,
        c2w=None if poses is None else poses[None].float(),
        assumed=assumed,
    )
    loaded = LoadedPhotos(views, tuple(photos))
    if len(set(sizes)) > 1 or not all(assumed) or read_lens is None:
        return loaded
    lens = read_lens(views)
    return loaded if lens is None else _straightened(loaded, files, lens)


def _straightened(
    loaded: LoadedPhotos, files: Sequence[Path], lens: Lens
) -> LoadedPhotos:
    """Photos of one size and lens as a plain pinhole would have taken them."""
    say(
        "lens.straightened",
        f"it bends straight lines (k1 {lens.distortion[0]:.3f}); the photos are straightened",
    )
    views = loaded.views
    # Photos of one size: the frame of each is all of it.
    frame = loaded.photos[0].frame.through(lens)
    enough = ENOUGH * max(frame.target)
    images = [_to_tensor(frame.cut(read_image(file, enough))) for file in files]
    intrinsics = frame.follow(views.intrinsics[0, 0].double()).to(views.intrinsics)
    views = replace(
        views,
        images=torch.stack(images)[None],
        intrinsics=intrinsics.expand_as(views.intrinsics),
    )
    photos = tuple(replace(photo, frame=frame) for photo in loaded.photos)
    return LoadedPhotos(views, photos)


def find_photos(paths: Pictures, frames: int = USUAL_FRAMES) -> list[Path]:
    """The image files named by `paths`.

    A folder stands for its images in natural order (img2 before img10), or for those of its
    `images` folder when it has none itself; a video for at most `frames` of its frames. Raises
    InputError when a path is not there.
    """
    given = as_files(paths)
    files: list[Path] = []
    for path in given:
        refuse_elsewhere(path)
    for path in (one for each in given for one in expand(each)):
        if path.is_dir():
            files += _images_in(path)
        elif path.suffix.lower() in VIDEO_SUFFIXES and path.is_file():
            files += take_frames(path, frames)
        elif path.is_file():
            files.append(path)
        elif path.exists():  # a pipe, of which nobody knows when it ends
            raise InputError(f"{path}: not a regular file.")
        else:
            raise InputError(f"{path}: no such file or folder.")
    if not files:
        raise InputError(
            "No photos given: name two or more image files, or a folder of them."
        )
    return only_photos(files)


def packaged_pair() -> tuple[list[str], Path]:
    """The photo pair that scikit-image ships (Middlebury 2014, Motorcycle), and its calibration."""
    import skimage

    folder = Path(skimage.__file__).parent / "data"
    photos = [str(folder / f"motorcycle_{side}.png") for side in ("left", "right")]
    return photos, Path(__file__).with_name("motorcycle_cameras.json")


def evenly(items: Sequence[Item], most: int | None) -> list[Item]:
    """At most `most` of the items, spread evenly from the first to the last; all for None."""
    if most is None or len(items) <= most:
        return list(items)
    places = np.linspace(0, len(items) - 1, most).round().astype(int)
    return [items[place] for place in places]


# Images out


def save_image(image: Float[Tensor, "3 height width"], path: str | Path) -> None:
    """Write an image as 8-bit PNG (by suffix also JPEG or WebP).

    It is clipped to [0, 1], times 255, to nearest, half to even. An image read at its own size
    comes back as the very same bytes per pixel.
    """
    if image.dim() != 3 or image.shape[0] != 3:
        raise ValueError(
            f"save_image: expected shape [3, height, width], got {list(image.shape)}"
        )
    if not torch.isfinite(image).all():
        raise ValueError(
            f"save_image: the image for {path} holds values that are not finite"
        )
    save_pixels(to_bytes(image), path)


def save_pixels(pixels: Pixels, path: str | Path, *, is_photo: bool = True) -> None:
    """`save_image` for an image that is bytes already.

    Not `is_photo`: the file says so, and is left out where a folder of photos is read.
    """
    with atomic_write(path) as partial:
        if not is_photo:
            _save_marked(Image.fromarray(pixels), partial)
        elif partial.suffix.lower() == ".png":
            partial.write_bytes(encode_png(pixels))
        else:
            Image.fromarray(pixels).save(partial, quality=95)  # of JPEG and WebP


def _save_marked(image: Image.Image, path: Path) -> None:
    text = PngInfo()
    text.add_text("Software", MADE_HERE)
    exif = Image.Exif()
    exif[ExifTags.Base.Software] = MADE_HERE
    image.save(path, quality=95, pnginfo=text, exif=exif, compress_level=1)


def to_bytes(image: Float[Tensor, "3 height width"]) -> Pixels:
    """uint8 `[height, width, 3]` of an sRGB image, rounded as `save_image` states."""
    levels = image.detach().cpu().float().clamp(0, 1).mul_(255).round_()
    return levels.to(torch.uint8).permute(1, 2, 0).contiguous().numpy()


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
    pixels = np.array(image, dtype=np.float32) / 255
    return torch.from_numpy(pixels).permute(2, 0, 1).contiguous()


# Photos in


def _check_arguments(fov: float | None, size: int | None) -> None:
    if fov is not None and not 0 < fov < 180:
        raise InputError(f"--fov: expected degrees above 0 and below 180, got {fov:g}.")
    if size is not None and size < 1:
        raise InputError(f"--size: expected at least 1 pixel, got {size}.")


def expand(path: str | Path) -> list[Path]:
    """The files that a path with * or ? stands for, where no shell expanded it; else itself."""
    text = str(path)
    if not any(sign in text for sign in "*?[") or Path(text).exists():
        return [Path(path)]
    folder, name = os.path.split(text)
    if Path(folder).is_dir():  # "holiday [2024]" has signs of its own
        text = os.path.join(glob.escape(folder), name)
    files = sorted(map(Path, glob.glob(text)), key=natural)
    if not files:
        raise InputError(f"{path}: no such file or folder.")
    return files


def images_of_folder(folder: Path, suffixes: tuple[str, ...] = SUFFIXES) -> list[Path]:
    """The images that lie in the folder itself, in natural order."""
    images = []
    for path in folder.iterdir() if folder.is_dir() else ():
        hidden = path.name.startswith(".")  # such as macOS's ._IMG_0001.jpg
        if path.suffix.lower() in suffixes and not hidden and path.is_file():
            images.append(path)
    return sorted(images, key=natural)


def _images_in(folder: Path) -> list[Path]:
    for place in (folder, folder / "images"):
        if images := images_of_folder(place):
            return images
    raise InputError(f"{folder}: {_what_else(folder)}")


def _what_else(folder: Path) -> str:
    """Why there are no images in a folder, and where some are."""
    inside = sorted(folder.iterdir(), key=natural)
    raw = [path.name for path in inside if path.suffix.lower() in RAW_SUFFIXES]
    if raw:
        return f"only raw files ({raw[0]}); {DEVELOP}"
    deeper = (
        one
        for path in inside
        if path.is_dir()
        for one in sorted(path.iterdir(), key=natural)
    )
    looked_at = (*inside, *itertools.islice(deeper, MOST_LOOKED_AT))
    places = [str(path) for path in looked_at if images_of_folder(path)]
    if places:
        return f"no images in this folder, but in {', '.join(places[:6])}: give these."
    return "no images in this folder."


def _check_shapes(files: Sequence[Path], sizes: Sequence[tuple[int, int]]) -> None:
    for file, (height, width) in zip(files, sizes):
        if max(height, width) > NARROWEST * min(height, width):
            raise InputError(
                f"{file}: {width}x{height} pixels are a strip and no photo; leave it out."
            )


def _names(files: Sequence[Path], names: Sequence[str] | None) -> tuple[str, ...]:
    """The given names, or the files' own without suffix, each usable as a file name."""
    if names is None:
        names = [file.stem for file in files]
    if len(names) != len(files):
        raise InputError(
            f"names: expected one per photo ({len(files)}), got {len(names)}."
        )
    return tuple(unique_names(names))


def _as_view(
    name: str,
    file: Path,
    size: tuple[int, int],
    intrinsics: Intrinsics,
    target: tuple[int, int],
) -> tuple[Float[Tensor, "3 height width"], Photo]:
    """The part of a photo that is used, at the views' size, and the record of it."""
    height, width = size
    frame = frame_for(size, target).through(intrinsics.lens)
    fx, fy = intrinsics.normalised.diagonal()[:2].tolist()
    image = decode(file, ENOUGH * max(target))
    return _to_tensor(frame.cut(image.pixels)), Photo(
        name=name,
        file=origin(file),
        sha256=image.sha256,
        size=frame.source,
        frame=frame,
        intrinsics_source=intrinsics.source,
        focal=(fx * width, fy * height),
        mask=None if intrinsics.mask is None else str(intrinsics.mask),
    )


def _warn_of_losses(photos: Sequence[Photo]) -> None:
    first: dict[str, str] = {}
    for photo in photos:
        height, width = photo.frame.target
        so_that = f"so that all photos are {width}x{height}."
        if photo.frame.cropped > 0.02:
            warn(f"{photo.file}: {photo.frame.cropped:.0%} is cropped away, {so_that}")
        if photo.frame.scale > 1.05:
            warn(f"{photo.file}: enlarged {photo.frame.scale:.1f} times, {so_that}")
        twin = first.setdefault(photo.sha256, photo.file)
        if twin != photo.file:
            warn(f"{twin} and {photo.file} are the same image.")
