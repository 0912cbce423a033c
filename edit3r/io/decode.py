"""Read one image file of any usual format as upright 8-bit sRGB pixels, with the focal length that
its EXIF states.

Whatever is wrong with a file becomes one sentence that names it.
"""

import contextlib
import io
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import ExifTags, Image, ImageCms, ImageOps, UnidentifiedImageError

from edit3r.errors import InputError, MissingDependencyError
from edit3r.reporting import warn

MAX_PIXELS = 1 << 27
"""Largest image that is read, 134 megapixels: beyond every phone and camera, well below what fills
the memory.
"""

READABLE = "JPEG, PNG, WebP, TIFF, AVIF, or HEIC with the extra edit3r[heic]"

_FULL_FRAME_DIAGONAL = math.hypot(
    36, 24
)  # [mm]; CIPA DCG-001 defines the 35 mm equivalent by the diagonal

_UNIT_MM = {
    2: 25.4,
    3: 10.0,
    4: 1.0,
    5: 1e-3,
}  # FocalPlaneResolutionUnit: inch, cm, mm, um
FORMATS = ("JPEG", "PNG", "BMP", "GIF", "PPM", "WEBP", "TIFF", "JPEG2000")
"""What Pillow may take a file for: for EPS, for one, it would start another program. `Image.open`
always gets these.
"""

_HEIC_BRANDS = {b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1"}


@dataclass(frozen=True)
class DecodedImage:
    """A decoded file: pixels as a viewer would show them, and the focal length its EXIF states."""

    pixels: Image.Image  # mode RGB, upright, sRGB
    focal: (
        float | None
    )  # [pixels of `pixels`], same in x and y; None: EXIF does not say
    focal_source: str  # such as "EXIF 35 mm equivalent (26 mm)"; "" when focal is None
    transparent: bool = False  # some of it was see-through and now shows white


def decode(path: str | Path) -> DecodedImage:
    """Read an image: EXIF orientation applied, colour profile converted to sRGB, alpha laid over
    white, 16 bits cut to 8, the first frame of several. Raises InputError, or
    MissingDependencyError for HEIC without the extra.
    """
    path = Path(path)
    _check_is_file(path)
    with _opened(path) as image:
        if image.width * image.height > MAX_PIXELS:
            raise InputError(_too_large(path, f"{image.width}x{image.height}"))
        focal, source = _exif_focal(image, path)
        try:
            image.load()
            pixels, transparent = _to_srgb(image, path)
            return DecodedImage(
                _upright(image, pixels, path), focal, source, transparent
            )
        except InputError:
            raise
        except (
            Exception
        ) as error:  # damaged files make Pillow's decoders raise almost anything
            raise InputError(
                f"{path}: the picture is damaged or cut off ({_reason(error)}); copy it again."
            ) from None


def read_image(path: str | Path) -> Image.Image:
    """The upright sRGB pixels of an image file (mode RGB); see `decode`."""
    return decode(path).pixels


def image_size(path: str | Path) -> tuple[int, int]:
    """(height, width) of the upright image from its header, without decoding the pixels."""
    path = Path(path)
    _check_is_file(path)
    with _opened(path) as image:
        turned = _orientation(image, path) in (5, 6, 7, 8)
        return (image.width, image.height) if turned else (image.height, image.width)


def _check_is_file(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path}: expected a picture file, got a folder.")
    if not path.exists():
        raise InputError(f"{path}: no such file.")
    if not path.is_file():
        raise InputError(f"{path}: not a regular file.")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty (0 bytes).")


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    head = _head(path)
    if head[4:8] == b"ftyp" and head[8:12] in _HEIC_BRANDS:
        _register_heic(path)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # Pillow's own remarks; what matters is raised or said by the callers
        with _open(path) as image:
            yield image


def _open(path: Path) -> Image.Image:
    try:
        return Image.open(path, formats=_formats(path))
    except Image.DecompressionBombError:
        raise InputError(_too_large(path, "far too many pixels")) from None
    except UnidentifiedImageError:
        raise InputError(
            f"{path}: not a picture that can be read; expected {READABLE}."
        ) from None
    except PermissionError:
        raise InputError(f"{path}: no permission to read it.") from None
    except Exception as error:  # a damaged header, see decode
        raise InputError(
            f"{path}: the picture is damaged ({_reason(error)}); copy it again."
        ) from None


def _too_large(path: Path, found: str) -> str:
    return f"{path}: {found}; pictures of at most {MAX_PIXELS // 10**6} megapixels are read. Scale it down first."


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text[:120] or type(error).__name__


def _formats(path: Path) -> Sequence[str]:
    """What Pillow may take the file for; never one that starts another program, such as EPS,
    whatever its name.
    """
    if _head(path)[4:8] != b"ftyp":
        return FORMATS
    Image.init()  # an older Pillow has no AVIF, and HEIF is there once it is registered
    return [name for name in ("AVIF", "HEIF") if name in Image.OPEN]


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(12)
    except OSError:
        return b""  # opening it as an image gives the reason


def _register_heic(path: Path) -> None:
    try:
        from pi_heif import (
            register_heif_opener,  # decoder only, without the GPL encoder
        )
    except ImportError:
        raise MissingDependencyError(
            f'{path}: a HEIC photo needs one more package: pip install "edit3r[heic]", or export '
            "the photo as JPEG."
        ) from None
    register_heif_opener()


def _to_srgb(image: Image.Image, path: Path) -> tuple[Image.Image, bool]:
    """Any Pillow mode to RGB in sRGB, and whether some of it was see-through."""
    if (
        getattr(image, "n_frames", 1) > 1 and image.format != "MPO"
    ):  # MPO: phones keep a preview behind the photo
        warn(f"{path}: holds {image.n_frames} pictures; the first is used.")
    if image.mode.startswith("I;16") or image.mode in ("I", "F"):
        return _from_high_depth(image, path), False
    if not image.has_transparency_data:
        return _through_profile(image, image.info.get("icc_profile"), path), False
    image = image.convert("RGBA")
    alpha = image.getchannel("A")
    opaque = _through_profile(image.convert("RGB"), image.info.get("icc_profile"), path)
    white = Image.new("RGB", image.size, "white")
    white.paste(opaque, mask=alpha)
    return white, alpha.getextrema()[0] < 255


def _from_high_depth(image: Image.Image, path: Path) -> Image.Image:
    """Grey of more than 8 bits: 16-bit values keep their high byte, as Pillow does for 16-bit
    colour.
    """
    low, high = image.getextrema()
    if image.mode == "F" or low < 0 or high > 65535:
        raise InputError(
            f"{path}: grey values of mode {image.mode} from {low:g} to {high:g}; expected 8 or "
            "16 bits per channel."
        )
    return (
        image.convert("I")
        .point(lambda value: value * (1 / 256))
        .convert("L")
        .convert("RGB")
    )


def _through_profile(
    image: Image.Image, profile: bytes | None, path: Path
) -> Image.Image:
    if image.mode not in ("RGB", "CMYK", "L"):
        image = image.convert("RGB")
    if not profile:
        return image.convert("RGB")
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if image.mode == "RGB" and "sRGB" in ImageCms.getProfileDescription(source):
            return (
                image  # as most cameras say; converting would cost time and round twice
            )
        return ImageCms.profileToProfile(
            image, source, ImageCms.createProfile("sRGB"), outputMode="RGB"
        )
    except (ImageCms.PyCMSError, OSError, ValueError):
        warn(f"{path}: its colour profile cannot be used; colours are taken as sRGB.")
        return image.convert("RGB")


def _upright(image: Image.Image, pixels: Image.Image, path: Path) -> Image.Image:
    turn = _orientation(image, path)
    if turn not in range(2, 9):
        return pixels
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = turn
    tagged = pixels.copy()
    tagged.info["exif"] = exif.tobytes()
    return ImageOps.exif_transpose(tagged)


def _orientation(image: Image.Image, path: Path) -> int:
    """Value of tag 274, 1 (upright) when there is none or EXIF cannot be read; then with a warning
    naming `path`.
    """
    try:
        return int(image.getexif().get(ExifTags.Base.Orientation, 1))
    except Exception:  # EXIF is a foreign format inside a foreign format
        warn(f"{path}: its EXIF data cannot be read; the picture is taken as upright.")
        return 1


def _exif_focal(image: Image.Image, path: Path) -> tuple[float | None, str]:
    """Focal length [pixels of the stored image] and who says so; (None, "") when nobody does.

    From the 35 mm equivalent, else from focal length and sensor resolution (whose unit may be
    inches or metric).
    """
    try:
        tags = image.getexif().get_ifd(ExifTags.IFD.Exif)
        equivalent = _positive(tags.get(ExifTags.Base.FocalLengthIn35mmFilm))
        millimetres = _positive(tags.get(ExifTags.Base.FocalLength))
        density = _positive(tags.get(ExifTags.Base.FocalPlaneXResolution))
        unit = _UNIT_MM.get(int(tags.get(ExifTags.Base.FocalPlaneResolutionUnit, 2)))
        recorded = _positive(tags.get(ExifTags.Base.ExifImageWidth)) or image.width
    except Exception:  # see _orientation
        return None, ""
    focal, source = None, ""
    if equivalent:
        focal = equivalent * math.hypot(*image.size) / _FULL_FRAME_DIAGONAL
        source = f"EXIF 35 mm equivalent ({equivalent:g} mm)"
    elif millimetres and density and unit:
        focal = millimetres * density / unit * image.width / recorded
        source = f"EXIF focal length and sensor resolution ({millimetres:g} mm)"
    if focal is not None and not 0.1 < focal / max(image.size) < 50:
        warn(f"{path}: EXIF states an impossible focal length; it is ignored.")
        return None, ""
    return focal, source


def _positive(value: object) -> float | None:
    """An EXIF number if it is one and says something (0, 0/0 and text do not)."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None
