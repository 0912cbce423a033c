"""The folder of a recoloured multi-view set, and the masks that data sets bring along.

images/NAME.png      every used photo, recoloured alike: the target
masks/ID/NAME.png    soft masks of each region, white inside, greys at soft edges; no file: the photo does not show it
recolor.json         regions, parameters, views left out
cameras.json         intrinsics and poses of images/, where the photos came with a camera file
sheet.png            photo, regions and result of each view

NAME is the photo's name without suffix. Masks of a data set may also be one image per photo (`masks/NAME.png`) whose
values are object numbers, 0 being none.
"""

import colorsys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image, ImageDraw
from torch import Tensor

from edit3r.errors import InputError
from edit3r.geometry.cameras import to_pixels
from edit3r.io.cameras import CAMERA_FILES, PosedCamera, read_cameras, write_cameras
from edit3r.io.decode import FORMATS
from edit3r.io.images import LoadedPhotos, Photo, evenly, save_image, save_pixels, to_bytes
from edit3r.io.masks import fitted_mask, read_mask
from edit3r_recolor.scene import Images, Masks, SceneRecipe

RECIPE = "recolor.json"
MASKS = "masks"
MOST_LABELS = 1000  # an image with more values than this is a photo or a soft mask, not a map of object numbers
MOST_ROWS = 12  # views on the sheet
CELL = 320  # longer side of an image on the sheet [pixels]


def write_folder(folder: Path, photos: LoadedPhotos, masks: Masks, recipe: SceneRecipe, images: Images) -> None:
    """Write everything into an existing folder; `images` are of the processed views alone."""
    used = recipe.processed
    names = [recipe.views[view].name for view in used]
    (folder / "images").mkdir()
    for name, image in zip(names, images):
        save_image(image, folder / "images" / f"{name}.png")
    write_masks(folder / MASKS, names, [region.id for region in recipe.regions], masks[:, used])
    recipe.save(folder / RECIPE)
    cameras = [_camera(photos, view) for view in used]
    if any(camera is not None for camera in cameras):
        write_cameras(folder / "cameras.json", [camera for camera in cameras if camera is not None])
    save_sheet(folder / "sheet.png", photos.views.images[0, used], masks[:, used], images, names)


def write_masks(folder: Path, names: list[str], numbers: list[int], masks: Masks) -> None:
    """Write one folder per object, named by its number; views that do not show it get no file."""
    for number, of_object in zip(numbers, masks):
        own = folder / str(number)
        own.mkdir(parents=True, exist_ok=True)
        for name, mask in zip(names, of_object):
            if mask.any():
                Image.fromarray((mask * 255).round().to(torch.uint8).cpu().numpy()).save(own / f"{name}.png")


def read_masks(folder: Path, photos: tuple[Photo, ...]) -> Masks:
    """Read masks in [0, 1] of every object in every photo, on their views. Raises InputError when there are none."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of masks.")
    objects = sorted((p for p in folder.iterdir() if p.is_dir()), key=_by_number)
    masks = [_one_object(own, photos) for own in objects] if objects else _label_maps(folder, photos)
    masks = [mask for mask in masks if mask.any()]
    if not masks:
        raise InputError(
            f"{folder}: no masks for these photos; expected a folder per object with files such as "
            f"{photos[0].name}.png, or {photos[0].name}.png itself with object numbers."
        )
    return torch.stack(masks)


def _by_number(path: Path) -> tuple:
    return (0, int(path.name), "") if path.name.isdecimal() else (1, 0, path.name)


def _one_object(folder: Path, photos: tuple[Photo, ...]) -> Float[Tensor, "view height width"]:
    files = [_file_of(folder, photo) for photo in photos]
    return torch.stack([_none(p) if file is None else read_mask(file, p.frame) for p, file in zip(photos, files)])


def _none(photo: Photo) -> Float[Tensor, "height width"]:
    return torch.zeros(photo.frame.target)


def _file_of(folder: Path, photo: Photo) -> Path | None:
    return min((p for p in folder.iterdir() if p.is_file() and p.stem == photo.name), default=None)


def _label_maps(folder: Path, photos: tuple[Photo, ...]) -> list[Float[Tensor, "view height width"]]:
    """Read one mask per object number from images that hold the numbers."""
    files = [_file_of(folder, photo) for photo in photos]
    maps = [None if file is None else _label_map(file) for file in files]
    numbers = sorted({int(n) for labels in maps if labels is not None for n in np.unique(labels)} - {0})
    if len(numbers) > MOST_LABELS:
        raise InputError(f"{folder}: {len(numbers)} different values; expected object numbers, or a folder per object.")

    def mask(number: int, photo: Photo, file: Path | None, labels: np.ndarray | None) -> Float[Tensor, "height width"]:
        if file is None or labels is None:
            return _none(photo)
        return fitted_mask(Image.fromarray(((labels == number) * 255).astype(np.uint8)), photo.frame, file)

    return [torch.stack([mask(number, *view) for view in zip(photos, files, maps)]) for number in numbers]


def _label_map(file: Path) -> np.ndarray:
    """Read object numbers `[H, W]` as stored: grey levels, palette indices or 16-bit values."""
    try:
        with Image.open(file, formats=FORMATS) as image:
            values = np.array(image)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"{file}: cannot be read as a mask ({error}).") from None
    if values.ndim != 2:
        raise InputError(f"{file}: a colour picture; expected object numbers as grey levels or palette indices.")
    return values.astype(np.int64)


def _camera(photos: LoadedPhotos, view: int) -> PosedCamera | None:
    """Return a view's camera: pose as in the file beside its photo, intrinsics of the image that is written."""
    photo = photos.photos[view]
    known = _known_camera(photo)
    if known is None:
        return None
    height, width = photo.frame.target
    pixels = to_pixels(photos.views.intrinsics[0, view].double(), photo.frame.target)
    has_intrinsics = photo.intrinsics_source.startswith("camera file")
    return PosedCamera(f"images/{photo.name}.png", width, height, pixels.numpy() if has_intrinsics else None, known.c2w)


def _known_camera(photo: Photo) -> PosedCamera | None:
    """Find a photo's camera in a camera file beside it or one folder up."""
    file = Path(photo.file).resolve()
    for place in (file.parent, file.parent.parent):
        for path in (place / name for name in CAMERA_FILES):
            cameras = read_cameras(path) if path.is_file() else []
            found = next((camera for camera in cameras if (place / camera.file).resolve() == file), None)
            if found is not None:
                return found
    return None


def save_sheet(path: Path, photos: Images, masks: Masks, images: Images, names: list[str]) -> None:
    """Write the sheet, a row a view of photo, regions and result; of many views an even choice."""
    rows = evenly(range(len(photos)), MOST_ROWS)
    columns = photos, _painted(photos, masks), images
    lines = [torch.cat([_cell(column[row]) for column in columns], -1) for row in rows]
    sheet = Image.fromarray(to_bytes(torch.cat(lines, -2)))
    draw = ImageDraw.Draw(sheet)
    for index, row in enumerate(rows):
        place = (4, index * lines[0].shape[-2] + 4)
        draw.rectangle(draw.textbbox(place, names[row]), fill=(0, 0, 0))
        draw.text(place, names[row], fill=(255, 255, 255))
    save_pixels(np.asarray(sheet), path)


def _painted(photos: Images, masks: Masks) -> Images:
    """Draw grey photos with every region in a colour of its own, the same in all views."""
    shown = 0.6 * photos.mean(1, keepdim=True).expand(-1, 3, -1, -1)
    for number, mask in enumerate(masks):
        colour = shown.new_tensor(colorsys.hsv_to_rgb((number * 0.381966) % 1, 0.8, 1.0))  # golden ratio: far apart
        shown = torch.lerp(shown, colour[:, None, None].expand_as(shown), 0.6 * mask[:, None])
    return shown


def _cell(image: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 h w"]:
    factor = min(1.0, CELL / max(image.shape[-2:]))
    return F.interpolate(image[None], scale_factor=factor, mode="area")[0] if factor < 1 else image
