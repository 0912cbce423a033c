"""What EXIF says of a photo that matters here: which way up it is, and its focal length."""

import math
from pathlib import Path

from PIL import ExifTags, Image

from edit3r.reporting import warn

FULL_FRAME_DIAGONAL = math.hypot(36, 24)  # [mm]; CIPA DCG-001 defines the 35 mm equivalent by the diagonal

_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # FocalPlaneResolutionUnit: inch, cm, mm, um


def orientation(image: Image.Image, path: Path) -> int:
    """Value of tag 274, 1 (upright) when there is none or EXIF cannot be read; then with a warning naming `path`."""
    try:
        return int(image.getexif().get(ExifTags.Base.Orientation, 1))
    except Exception:  # EXIF is a foreign format inside a foreign format
        warn(f"{path}: its EXIF data cannot be read; the picture is taken as upright.")
        return 1


def exif_focal(image: Image.Image, path: Path) -> tuple[float | None, str]:
    """Focal length [pixels of the stored picture] and who says so; (None, "") when nobody does.

    From the 35 mm equivalent, else from focal length and sensor resolution (whose unit may be inches or metric).
    """
    try:
        tags = image.getexif().get_ifd(ExifTags.IFD.Exif)
        equivalent = _positive(tags.get(ExifTags.Base.FocalLengthIn35mmFilm))
        millimetres = _positive(tags.get(ExifTags.Base.FocalLength))
        density = _positive(tags.get(ExifTags.Base.FocalPlaneXResolution))
        unit = _UNIT_MM.get(int(tags.get(ExifTags.Base.FocalPlaneResolutionUnit, 2)))
        recorded = _positive(tags.get(ExifTags.Base.ExifImageWidth)) or image.width
    except Exception:  # see orientation
        return None, ""
    focal, source = None, ""
    if equivalent:
        focal = equivalent * math.hypot(*image.size) / FULL_FRAME_DIAGONAL
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
