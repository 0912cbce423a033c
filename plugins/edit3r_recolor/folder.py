"""The folder of a recoloured multi-view set, and the masks that data sets bring along.

images/NAME.png      every used photo, recoloured alike: the target augmented/NAME.png   the same
edit with an editor's faults (where asked for): the input masks/ID/NAME.png    soft masks of each
region, white inside, greys at soft edges; no file: the photo does not show it recolor.json
regions, parameters, faults, views left out: enough to replay cameras.json         intrinsics and
poses of images/, where a camera file beside the photos has them all sheet.png            photo,
regions and result of each view

NAME is the photo's name without suffix.
"""

import colorsys
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras
from edit3r.kit.contact_sheet import draw_sheet
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.photos.images import (
    LoadedPhotos,
    Photo,
    evenly,
    save_image,
    save_pixels,
)
from edit3r.kit.photos.masks import read_mask
from edit3r_recolor.scene import Images, Masks, SceneRecipe

RECIPE = "recolor.json"
MASKS = "masks"
MOST_ROWS = 12  # views on the sheet


def write_folder(
    folder: Path,
    photos: LoadedPhotos,
    masks: Masks,
    recipe: SceneRecipe,
    images: Images,
    augmented: Images | None,
) -> None:
    """Fill an existing folder; `images` and `augmented` are of the processed views alone."""
    used = recipe.processed
    names = [recipe.views[view].name for view in used]
    for kind, written in (("images", images), ("augmented", augmented)):
        if written is not None:
            (folder / kind).mkdir()
            for name, image in zip(names, written):
                save_image(image, folder / kind / f"{name}.png")
    numbers = [region.id for region in recipe.regions]
    write_masks(folder / MASKS, names, numbers, masks[:, used])
    recipe.save(folder / RECIPE)
    views = photos.views
    if views.c2w is not None:
        cameras = Cameras(views.c2w, views.intrinsics, views.image_size).select(used)
        files = [f"images/{name}.png" for name in names]
        write_cameras(folder / "cameras.json", posed_cameras(cameras, files))
    shown = evenly(range(len(used)), MOST_ROWS)
    originals = views.images[0, used][shown]
    columns = {
        "photo": originals,
        "regions": _painted(originals, masks[:, used][:, shown]),
        "result": images[shown],
    }
    if augmented is not None:
        columns["augmented"] = augmented[shown]
    sheet = draw_sheet(columns, names=[names[view] for view in shown])
    save_pixels(np.asarray(sheet), folder / "sheet.png")


def write_masks(
    folder: Path, names: list[str], numbers: list[int], masks: Masks
) -> None:
    """Write one folder per object, named by its number; views that do not show it get no file."""
    for number, of_object in zip(numbers, masks):
        own = folder / str(number)
        own.mkdir(parents=True, exist_ok=True)
        for name, mask in zip(names, of_object):
            if mask.any():
                pixels = (mask * 255).round().to(torch.uint8).cpu().numpy()
                Image.fromarray(pixels).save(own / f"{name}.png")


def read_masks(folder: Path, photos: tuple[Photo, ...]) -> Masks:
    """Masks in [0, 1] of every object in every photo. Raises InputError where there are none."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of masks.")
    objects = sorted((p for p in folder.iterdir() if p.is_dir()), key=_by_number)
    masks = [mask for own in objects if (mask := _one_object(own, photos)).any()]
    if not masks:
        name = photos[0].name
        raise InputError(
            f"{folder}: no masks for these photos; expected a folder per object with files such "
            f"as {name}.png."
        )
    return torch.stack(masks)


def read_masks_of(folder: Path, photos: tuple[Photo, ...], numbers: list[int]) -> Masks:
    """Read the masks of the objects with these numbers, as `write_masks` left them."""
    for number in numbers:
        if not (folder / str(number)).is_dir():
            raise InputError(
                f"{folder}: lacks the folder {number} with that object's masks."
            )
    masks = [_one_object(folder / str(number), photos) for number in numbers]
    return torch.stack(masks)


def _by_number(path: Path) -> tuple:
    return (0, int(path.name), "") if path.name.isdecimal() else (1, 0, path.name)


def _one_object(
    folder: Path, photos: tuple[Photo, ...]
) -> Float[Tensor, "view height width"]:
    paths = sorted(folder.iterdir(), reverse=True)
    files = {path.stem: path for path in paths if path.is_file()}
    masks = [
        read_mask(files[photo.name], photo.frame)
        if photo.name in files
        else torch.zeros(photo.frame.target)
        for photo in photos
    ]
    return torch.stack(masks)


def _painted(photos: Images, masks: Masks) -> Images:
    """Draw grey photos with every region in a colour of its own, the same in all views."""
    shown = 0.6 * photos.mean(1, keepdim=True).expand(-1, 3, -1, -1)
    for number, mask in enumerate(masks):
        hue = (number * 0.381966) % 1  # golden ratio: far apart
        colour = shown.new_tensor(colorsys.hsv_to_rgb(hue, 0.8, 1.0))
        colour = colour[:, None, None].expand_as(shown)
        shown = torch.lerp(shown, colour, 0.6 * mask[:, None])
    return shown
