"""Read one image file of any usual format as upright 8-bit sRGB pixels.

Whatever is wrong with a file becomes one sentence that names it.
"""

import contextlib
import io
import math
import re
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import cv2
import numpy as np
from PIL import ExifTags, Image, ImageCms, ImageOps, UnidentifiedImageError

from edit3r.contract.errors import InputError, MissingDependencyError, one_line
from edit3r.contract.reporting import warn
from edit3r.kit.files.atomic import digest_of
from edit3r.kit.photos.damage import damage_of

Answer = TypeVar("Answer")

MAX_PIXELS = 1 << 27
"""Largest image that is read whole, 134 megapixels: it takes half a gigabyte."""

MAX_JPEG_PIXELS = 1 << 28
"""Largest JPEG, 268 megapixels: phones make 200, and what is not needed of them is not decoded."""

WHOLE_PIXELS = 1 << 25
"""Up to here, 33 megapixels, JPEGs are decoded whole."""

MAX_LAYERS = 8
"""How often the pieces of a file may cover its image: once, or once per channel and mask."""

SUFFIXES = (
    *(".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".webp", ".tif", ".tiff"),
    *(".heic", ".heif", ".avif", ".bmp", ".ppm", ".pgm", ".jp2", ".jps", ".pns"),
)
"""Files taken from a folder; a file given by itself may be called anything."""

READABLE = "JPEG, PNG, WebP, TIFF, AVIF, or HEIC with the extra edit3r[heic]"

FORMATS = ("JPEG", "PNG", "BMP", "GIF", "PPM", "WEBP", "TIFF", "JPEG2000")
"""What Pillow may take a file for: for EPS, for one, it would start another program. `Image.open`
always gets these.
"""

RAW_SUFFIXES = (
    *(".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".rw2", ".orf", ".pef", ".srw"),
    *(".nrw", ".x3f", ".3fr", ".iiq"),
)
"""Files of cameras that hold what the sensor saw, and a small picture beside it."""
DEVELOP = "develop raw photos first, and export JPEG or TIFF."

# [mm]; CIPA DCG-001 defines the 35 mm equivalent by the diagonal.
_FULL_FRAME_DIAGONAL = math.hypot(36, 24)

WIDEST = 2.25  # long by short side of what a lens took at once; a sanity limit

# FocalPlaneResolutionUnit: inch, cm, mm, um: the format
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}

# Tags of TIFF.
_DNG_VERSION, _NEW_SUBFILE_TYPE, _IMAGE_WIDTH, _IMAGE_LENGTH = 50706, 254, 256, 257
_BITS, _PHOTOMETRIC, _PLANAR, _ROWS_PER_STRIP = 258, 262, 284, 278
_STRIP_SIZES, _TILE_WIDTH, _TILE_LENGTH, _TILE_SIZES = 279, 322, 323, 325

_PROJECTION = re.compile(
    rb"GPano:ProjectionType\W{1,9}(equirectangular|cylindrical|cube\w{0,9}|fisheye)",
    re.I,
)
_HEAD = 1 << 16  # bytes in which a file says how its colours are coded
# The transfer functions PQ (16) and HLG (18) of ITU-T H.273, in a PNG's chunk cICP and in the box
# colr of HEIC and AVIF.
_BRIGHT = re.compile(rb"cICP.[\x10\x12]|colrnclx..\x00[\x10\x12]", re.DOTALL)
_JPEG = ("JPEG", "MPO")
_GAIN_MAP = (
    b"hdr-gain-map"  # in the XMP of a JPEG with a second picture for bright screens
)
_SIDE_BY_SIDE = (".jps", ".pns")  # the two pictures of a stereo camera in one
_OPENING = threading.Lock()  # while Pillow's own limit is set aside

_HEIC_BRANDS = {b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1"}


@dataclass(frozen=True)
class ImageHeader:
    """What an image file says before its pixels are decoded."""

    size: tuple[int, int]  # (height, width) of the upright image
    focal: float | None  # [pixels of that], same in x and y; None: EXIF has none
    # such as "EXIF 35 mm equivalent (26 mm)"; "" without a focal length
    focal_source: str
    software: str  # that made the file; "" where it does not say
    remarks: tuple[str, ...]  # why what EXIF says of the lens is not believed


@dataclass(frozen=True)
class DecodedImage:
    """The pixels of an image file as a viewer would show them."""

    pixels: Image.Image  # mode RGB, upright, sRGB; smaller where less was enough
    sha256: str  # of the file
    alpha: Image.Image | None = None  # mode L, where some of it is see-through


def read_header(path: str | Path) -> ImageHeader:
    """What the file says of its image, which is read once for each state of the file.

    Raises InputError, or MissingDependencyError for HEIC without the extra.
    """
    path = Path(path)
    _check_is_file(path)
    status = path.stat()
    return _header_of(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4096)
def _header_of(path: Path, changed: int, length: int) -> ImageHeader:
    with _opened(path) as (image, _):
        turned = _orientation(image, path) in (5, 6, 7, 8)
        stored = image.size
        if image.format == "TIFF":  # which Pillow may have turned already
            tags = image.tag_v2  # type: ignore[attr-defined]
            stored = tags[ExifTags.Base.ImageWidth], tags[_IMAGE_LENGTH]
        focal, source, remark = _exif_focal(image, stored, path)
        software = _software(image)
    return ImageHeader(
        size=stored if turned else stored[::-1],
        focal=focal,
        focal_source=source,
        software=software,
        remarks=(remark,) if remark else (),
    )


def _software(image: Image.Image) -> str:
    """The program that says it made the file."""
    try:
        # Of a PNG, Exif is asked for after all pixels; ours say it before.
        if image.format == "PNG":
            return str(image.info.get("Software", ""))
        return str(image.getexif().get(ExifTags.Base.Software, ""))
    except Exception:  # see _orientation
        return ""


def image_size(path: str | Path) -> tuple[int, int]:
    """(height, width) of the upright image from its header, without decoding the pixels."""
    return read_header(path).size


def decode(path: str | Path, enough: int | None = None) -> DecodedImage:
    """Read an image file, of a very large JPEG only a copy whose longer side has at least `enough`
    pixels (None: all of it).

    EXIF orientation is applied, a colour profile converted to sRGB, alpha laid over white, 16 bits
    cut to 8, and of several images the first is taken. The file is opened once. Raises InputError,
    or MissingDependencyError for HEIC without the extra.
    """
    path = Path(path)
    with _opened(path) as (image, file):
        _check_size(image, path)
        _check_whole(image, path)
        _check_flat(image, path)
        _check_stereo(image, file, path)
        _tell_damage(image, file, path)
        _tell_bright(file, path)
        digest = _from_start(file, digest_of)
        try:
            _draft(image, enough)
            stored = _loaded(image, file, path)
            turn = _orientation(image, path)
            pixels, alpha = _to_srgb(stored, path)
            upright = _upright(pixels, turn)
            alpha = None if alpha is None else _upright(alpha, turn)
        except InputError:
            raise
        except Exception as error:  # Pillow's decoders raise almost anything
            raise InputError(
                f"{path}: the image is damaged or cut off ({one_line(error, 120)}); copy it again."
            ) from None
    return DecodedImage(upright, digest, alpha)


def read_image(path: str | Path, enough: int | None = None) -> Image.Image:
    """The upright sRGB pixels of an image file (mode RGB); see `decode`."""
    return decode(path, enough).pixels


# Opening


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[tuple[Image.Image, BinaryIO]]:
    """The image with its header read, and its file. Raises InputError."""
    _check_is_file(path)
    with warnings.catch_warnings(), contextlib.ExitStack() as stack:
        # Pillow's own remarks; what matters is raised or said by the callers.
        warnings.simplefilter("ignore")
        try:
            # By its name, Pillow maps grey TIFFs into memory and turns them wrongly.
            file = stack.enter_context(path.open("rb"))
            image = _without_bomb_check(file, _formats(file, path))
        except UnidentifiedImageError:
            if path.suffix.lower() in RAW_SUFFIXES:
                raise InputError(f"{path}: a raw file; {DEVELOP}") from None
            raise InputError(
                f"{path}: not an image that can be read; expected {READABLE}."
            ) from None
        except PermissionError:
            raise InputError(f"{path}: no permission to read it.") from None
        except (InputError, MissingDependencyError):
            raise
        except Exception as error:  # a damaged header, see decode
            raise InputError(
                f"{path}: the image is damaged ({one_line(error, 120)}); copy it again."
            ) from None
        with image:
            if image.format == "TIFF":
                _check_tiff(image, path)
            yield image, file


def _from_start(file: BinaryIO, read: Callable[[BinaryIO], Answer]) -> Answer:
    """What `read` makes of the whole file; Pillow then goes on where it was."""
    place = file.tell()
    file.seek(0)
    try:
        return read(file)
    finally:
        file.seek(place)


def _check_is_file(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path}: expected an image file, got a folder.")
    if not path.exists():
        raise InputError(f"{path}: no such file.")
    if not path.is_file():
        raise InputError(f"{path}: not a regular file.")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty (0 bytes).")


def _formats(file: BinaryIO, path: Path) -> tuple[str, ...]:
    """What Pillow may take the file for; never one that starts another program.

    EPS is such a one, whatever the file is called.
    """
    head = _from_start(file, lambda file: file.read(12))
    if head[4:8] != b"ftyp":
        return FORMATS
    if head[8:12] in _HEIC_BRANDS:
        _register_heic(path)
    Image.init()  # an older Pillow has no AVIF, and HEIF is there once it is registered
    return tuple(name for name in ("AVIF", "HEIF") if name in Image.OPEN)


def _register_heic(path: Path) -> None:
    try:
        # Decoder only, without the GPL encoder.
        from pi_heif import register_heif_opener
    except ImportError:
        raise MissingDependencyError(
            f'{path}: a HEIC photo needs one more package: pip install "edit3r[heic]", or export '
            "the photo as JPEG."
        ) from None
    register_heif_opener()


def _check_tiff(image: Image.Image, path: Path) -> None:
    """Raise InputError for a raw file (a thumbnail is in front) and what Pillow misreads."""
    tags = image.tag_v2  # type: ignore[attr-defined]
    reduced = tags.get(_NEW_SUBFILE_TYPE, 0)
    named = path.suffix.lower() in RAW_SUFFIXES
    if named or _DNG_VERSION in tags or (isinstance(reduced, int) and reduced & 1):
        raise InputError(f"{path}: a raw file, with a thumbnail in front; {DEVELOP}")
    bits = tags.get(_BITS, (1,))
    planar = tags.get(_PLANAR) == 2 and len(bits) > 1
    kinds = {
        f"of {bits[0]} bits per channel": bits[0] not in (1, 2, 4, 8, 16, 32),
        "of 16 bits, each channel by itself": bits[0] == 16 and planar,
        "of 16 bits, with 0 as white": bits[0] == 16 and tags.get(_PHOTOMETRIC) == 0,
    }
    for kind, is_that in kinds.items():
        if is_that:
            raise InputError(
                f"{path}: a TIFF {kind}, which is not read; save it as PNG, or as TIFF of 8 bits."
            )


def _check_whole(image: Image.Image, path: Path) -> None:
    """Raise InputError for a TIFF without some of its strips or tiles, which would be black."""
    if image.format != "TIFF":
        return
    tags = image.tag_v2  # type: ignore[attr-defined]
    bits = tags.get(_BITS, (1,))
    planar = tags.get(_PLANAR) == 2
    parts = tags.get(_STRIP_SIZES, tags.get(_TILE_SIZES, ()))
    expected = _parts_of(tags) * (len(bits) if planar else 1)
    if len(parts) < expected or not all(parts):
        raise InputError(f"{path}: parts of the image are missing; copy it again.")


def _parts_of(tags: Mapping[int, Any]) -> int:
    """How many strips or tiles the image of a TIFF has."""
    width, height = tags[_IMAGE_WIDTH], tags[_IMAGE_LENGTH]
    across = math.ceil(width / tags.get(_TILE_WIDTH, width))
    return across * math.ceil(
        height / tags.get(_TILE_LENGTH, tags.get(_ROWS_PER_STRIP, height))
    )


def _check_size(image: Image.Image, path: Path) -> None:
    """Raise InputError for an image, or pieces of it, that would take too long to decode."""
    width, height = image.size
    most = MAX_JPEG_PIXELS if image.format in _JPEG else MAX_PIXELS
    if width * height > most:
        raise _too_large(path, f"{width}x{height}", most)
    boxes = [piece[1] or (0, 0, 0, 0) for piece in getattr(image, "tile", ())]
    pieces = sum((right - left) * (low - top) for left, top, right, low in boxes)
    if pieces > MAX_LAYERS * width * height:
        raise InputError(
            f"{path}: the image is damaged ({len(boxes)} pieces that cover each other); copy it "
            "again."
        )


def _too_large(path: Path, given: str, most: int) -> InputError:
    kind = "images" if most == MAX_PIXELS else "JPEGs"
    return InputError(
        f"{path}: {given}; {kind} of at most {most // 10**6} megapixels are read. Scale it down "
        "first."
    )


def _without_bomb_check(file: BinaryIO, formats: tuple[str, ...]) -> Image.Image:
    """The image with its header read; how large it may be is `_check_size`'s to say."""
    with _OPENING:
        before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            return Image.open(file, formats=formats)
        finally:
            Image.MAX_IMAGE_PIXELS = before


def _check_flat(image: Image.Image, path: Path) -> None:
    """Raise InputError for a picture of all that is around, which no lens takes."""
    xmp = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
    text = xmp if isinstance(xmp, bytes) else str(xmp).encode("utf-8", "replace")
    projection = _PROJECTION.search(text)
    if projection:
        kind = projection[1].decode("ascii").lower()
        raise InputError(
            f"{path}: a picture of all around (GPano, {kind}), which no lens takes; cut ordinary "
            "views out of it first, and give these."
        )


def _check_stereo(image: Image.Image, file: BinaryIO, path: Path) -> None:
    """Raise InputError for two pictures in one, and warn of a second one of the same size."""
    parts = getattr(image, "applist", ())
    if path.suffix.lower() in _SIDE_BY_SIDE or any(
        name == "APP3" and content.startswith(b"_JPSJPS_") for name, content in parts
    ):
        raise InputError(
            f"{path}: a stereo photo with both pictures side by side; cut it in two, and give both."
        )
    is_bright = _GAIN_MAP in (image.info.get("xmp") or b"")
    if image.format == "MPO" and not is_bright and _second_size(file) == image.size:
        warn(
            f"{path}: holds two pictures of one size, as stereo cameras make them; the first is "
            "used. Save the other as a file of its own to use both."
        )


def _second_size(file: BinaryIO) -> tuple[int, int] | None:
    """(width, height) of the second picture in a file; None where there is none to be read."""
    content = io.BytesIO(_from_start(file, lambda file: file.read()))
    # a damaged one, which is not used, raises almost anything
    with contextlib.suppress(Exception), Image.open(content, formats=FORMATS) as image:
        image.seek(1)
        return image.size
    return None


def _tell_damage(image: Image.Image, file: BinaryIO, path: Path) -> None:
    if image.format in _JPEG and (damage := _from_start(file, damage_of)):
        warn(
            f"{path}: damaged inside ({damage}), so parts of it may be grey or shifted; copy it "
            "again from where it comes."
        )


def _tell_bright(file: BinaryIO, path: Path) -> None:
    if _BRIGHT.search(_from_start(file, lambda file: file.read(_HEAD))):
        warn(
            f"{path}: coded for bright screens (HDR), which is not undone: its colours are dull; "
            "export it as sRGB."
        )


def _draft(image: Image.Image, enough: int | None) -> None:
    """Let a large JPEG be decoded at a half, a quarter or an eighth, where that is enough."""
    if enough is None or math.prod(image.size) <= WHOLE_PIXELS:
        return
    width, height = image.size
    share = enough / max(width, height)
    image.draft(None, (math.ceil(width * share), math.ceil(height * share)))


# Pixels


def _loaded(image: Image.Image, file: BinaryIO, path: Path) -> Image.Image:
    """The first image of the file, decoded, with 8 bits per channel."""
    # MPO: phones keep a preview behind the photo. The number of images is not asked for, because
    # counting those of a TIFF can take minutes.
    if getattr(image, "is_animated", False) and image.format != "MPO":
        warn(f"{path}: holds several images; the first is used.")
    is_16_bit = any(";16" in str(piece[3]) for piece in getattr(image, "tile", ()))
    image.load()
    if image.mode.startswith("I;16") or image.mode in ("I", "F"):
        return _from_deep_grey(image, path)
    # Pillow keeps the high byte of 16-bit colour.
    if is_16_bit:
        highest = int(np.asarray(image.convert("RGB")).max())
        bits = _bits_used(256 * highest + 255, path)
        return image if bits == 16 else _low_bits(file, bits)
    return image


def _from_deep_grey(image: Image.Image, path: Path) -> Image.Image:
    """Grey of more than 8 bits: 16-bit values keep their high byte, as those of colour do; floats
    go from 0 to 1, or to 255.
    """
    values = np.asarray(image)
    low, high = float(values.min()), float(values.max())
    is_float = image.mode == "F"
    if not 0 <= low <= high <= (255 if is_float else 65535):  # or not a number
        raise InputError(
            f"{path}: grey values of mode {image.mode} from {low:g} to {high:g}; expected 8 or "
            "16 bits per channel, or floats from 0 to 1."
        )
    if is_float:
        levels = values * (255 if high <= 1 else 1)
        return Image.fromarray(np.rint(levels).astype(np.uint8))
    values = values >> (_bits_used(int(high), path) - 8)
    return Image.fromarray(values.astype(np.uint8))


def _low_bits(file: BinaryIO, bits: int) -> Image.Image:
    """16-bit colour by so many low bits, without its colour profile."""
    coded = np.frombuffer(_from_start(file, lambda file: file.read()), np.uint8)
    pixels = np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED))
    pixels = (pixels >> (bits - 8)).clip(0, 255).astype(np.uint8)
    channels = [2, 1, 0, 3][: pixels.shape[2]]  # OpenCV's order is BGR
    return Image.fromarray(np.ascontiguousarray(pixels[..., channels]))


def _bits_used(highest: int, path: Path) -> int:
    """How many of 16 bits a file uses whose highest value this is; said where it is fewer."""
    bits = next((bits for bits in (8, 10, 12) if highest < 1 << bits), 16)
    if bits < 16 and highest:
        warn(
            f"{path}: holds 16-bit values of {(1 << bits) - 1} at most; they are taken as "
            f"{bits}-bit ones."
        )
    return bits


def _to_srgb(image: Image.Image, path: Path) -> tuple[Image.Image, Image.Image | None]:
    """Any Pillow mode of 8 bits to RGB in sRGB, and its alpha where some of it is see-through."""
    profile = image.info.get("icc_profile")
    if not profile and "srgb" not in image.info:
        image = _through_gamma(image)
    if not image.has_transparency_data:
        return _through_profile(image, profile, path), None
    image = image.convert("RGBA")
    alpha = image.getchannel("A")
    opaque = _through_profile(image.convert("RGB"), profile, path)
    white = Image.new("RGB", image.size, "white")
    white.paste(opaque, mask=alpha)
    return white, alpha if alpha.getextrema() != (255, 255) else None


def _through_gamma(image: Image.Image) -> Image.Image:
    """A PNG that states another gamma than sRGB's, as programs that compute with light write."""
    gamma = image.info.get("gamma")
    if (
        not gamma
        or abs(gamma * 2.2 - 1) < 0.05
        or image.mode not in ("L", "RGB", "RGBA")
    ):
        return image
    # Few photos need it, and what it needs takes long to import.
    import torch

    from edit3r.kit.compute.colour import linear_to_srgb

    light = (torch.arange(256, dtype=torch.float64) / 255) ** (1 / gamma)
    levels = (255 * linear_to_srgb(light)).round().int().tolist()
    bands = list(image.split())
    colours = [band.point(levels) for band in bands[:3]]
    return Image.merge(image.mode, colours + bands[3:])


def _through_profile(
    image: Image.Image, profile: bytes | None, path: Path
) -> Image.Image:
    if image.mode not in ("RGB", "CMYK", "L"):
        image = image.convert("RGB")
    if not profile:
        return image if image.mode == "RGB" else image.convert("RGB")
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if image.mode == "RGB" and "sRGB" in ImageCms.getProfileDescription(source):
            return image  # as most cameras say; converting would round twice
        target = ImageCms.createProfile("sRGB")
        changed = ImageCms.profileToProfile(image, source, target, outputMode="RGB")
        assert changed is not None  # since it is not changed in place
        return changed
    except (ImageCms.PyCMSError, OSError, ValueError):
        warn(f"{path}: its colour profile cannot be used; colours are taken as sRGB.")
        return image.convert("RGB")


# EXIF


def _orientation(image: Image.Image, path: Path) -> int:
    """Value of tag 274; 1 (upright) without one. Warns where EXIF cannot be read."""
    try:
        turn = int(image.getexif().get(ExifTags.Base.Orientation, 1))
        return turn if turn in range(1, 9) else 1
    except Exception:  # EXIF is a foreign format inside a foreign format
        warn(f"{path}: its EXIF data cannot be read; the image is taken as upright.")
        return 1


def _upright(pixels: Image.Image, orientation: int) -> Image.Image:
    if orientation == 1:
        return pixels
    tagged = pixels.copy()
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    tagged.info["exif"] = exif.tobytes()
    return ImageOps.exif_transpose(tagged)


def _exif_focal(
    image: Image.Image, size: tuple[int, int], path: Path
) -> tuple[float | None, str, str]:
    """Focal length [pixels of the stored image], who says so, and why it is not believed.

    (None, "", "") where EXIF says nothing. From the 35 mm equivalent, else from focal length and
    sensor resolution (whose unit may be inches or metric).
    """
    try:
        tags = image.getexif().get_ifd(ExifTags.IFD.Exif)
        equivalent = _positive(tags.get(ExifTags.Base.FocalLengthIn35mmFilm))
        millimetres = _positive(tags.get(ExifTags.Base.FocalLength))
        density = _positive(tags.get(ExifTags.Base.FocalPlaneXResolution))
        unit = _UNIT_MM.get(int(tags.get(ExifTags.Base.FocalPlaneResolutionUnit, 2)))
        recorded = _positive(tags.get(ExifTags.Base.ExifImageWidth)) or size[0]
        height = _positive(tags.get(ExifTags.Base.ExifImageHeight))
    except Exception:  # see _orientation
        return None, "", ""
    if equivalent:
        focal = equivalent * math.hypot(*size) / _FULL_FRAME_DIAGONAL
        source = f"EXIF 35 mm equivalent ({equivalent:g} mm)"
    elif millimetres and density and unit:
        focal = millimetres * density / unit * size[0] / recorded
        source = f"EXIF focal length and sensor resolution ({millimetres:g} mm)"
    else:
        return None, "", ""
    doubt = ""
    if height and not _same_shape((recorded, height), size):
        doubt = (
            f"EXIF tells of {recorded:g}x{height:g} pixels, so the photo was cropped, and what "
            "EXIF says of the lens is not believed; --fov tells it."
        )
    elif max(size) > WIDEST * min(size):
        doubt = (
            "as wide as panoramas are, whose EXIF tells of the lens that swept, which is not "
            "believed; --fov tells it."
        )
    elif not 0.1 < focal / max(size) < 50:
        doubt = "EXIF states an impossible focal length; it is ignored."
    return (None, "", f"{path}: {doubt}") if doubt else (focal, source, "")


def _same_shape(first: tuple[float, float], second: tuple[float, float]) -> bool:
    """Whether two sizes have one shape, upright or on its side."""
    shapes = [max(size) / min(size) for size in (first, second)]
    return abs(shapes[0] / shapes[1] - 1) < 0.02


def _positive(value: object) -> float | None:
    """An EXIF number if it is one and says something (0, 0/0 and text do not)."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None
