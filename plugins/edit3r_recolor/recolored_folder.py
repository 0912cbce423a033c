"""The folder of a recoloured multi-view set.

images/NAME.png      every used photo, recoloured alike: the target
augmented/NAME.png   the same edit with an editor's faults (where asked for): the input
masks/ID/NAME.png    soft masks of each region, white inside
recolor.json         regions, parameters, faults, views left out: enough to replay
cameras.json         intrinsics and poses of images/, where the photos came with a camera file
sheet.png            photo, regions and result of each view
"""

from pathlib import Path

from torch import Tensor

from edit3r.geometry.cameras import to_pixels
from edit3r.io.cameras import CAMERA_FILES, PosedCamera, read_cameras, write_cameras
from edit3r.io.images import LoadedPhotos, Photo, save_image
from edit3r_recolor.mask_folder import write_masks
from edit3r_recolor.recipe import SceneRecipe
from edit3r_recolor.recolored_sheet import save_sheet
from edit3r_recolor.scene import Images, Masks

RECIPE = "recolor.json"
MASKS = "masks"


def write_folder(
    folder: Path, photos: LoadedPhotos, masks: Masks, recipe: SceneRecipe, images: Images, augmented: Images | None
) -> None:
    """Write everything into an existing folder; `images` and `augmented` are of the processed views alone."""
    used = recipe.processed
    names = [recipe.views[view].name for view in used]
    _write_pictures(folder / "images", names, images)
    if augmented is not None:
        _write_pictures(folder / "augmented", names, augmented)
    write_masks(folder / MASKS, names, [region.id for region in recipe.regions], masks[:, used])
    recipe.save(folder / RECIPE)
    cameras = [_camera(photos, view) for view in used]
    if any(camera is not None for camera in cameras):
        write_cameras(folder / "cameras.json", [camera for camera in cameras if camera is not None])
    originals = photos.views.images[0, used]
    save_sheet(folder / "sheet.png", originals, masks[:, used], images, augmented, names)


def _write_pictures(folder: Path, names: list[str], images: Images) -> None:
    folder.mkdir()
    for name, image in zip(names, images):
        save_image(image, folder / f"{name}.png")


def _camera(photos: LoadedPhotos, view: int) -> PosedCamera | None:
    """The view's camera: pose as in the file beside its photo, intrinsics of the picture that is written."""
    photo = photos.photos[view]
    known = _known_camera(photo)
    if known is None:
        return None
    height, width = photo.frame.target
    pixels: Tensor = to_pixels(photos.views.intrinsics[0, view].double(), photo.frame.target)
    has_intrinsics = photo.intrinsics_source.startswith("camera file")
    return PosedCamera(f"images/{photo.name}.png", width, height, pixels.numpy() if has_intrinsics else None, known.c2w)


def _known_camera(photo: Photo) -> PosedCamera | None:
    file = Path(photo.file).resolve()
    for place in (file.parent, file.parent.parent):
        for path in (place / name for name in CAMERA_FILES):
            cameras = read_cameras(path) if path.is_file() else []
            found = next((camera for camera in cameras if (place / camera.file).resolve() == file), None)
            if found is not None:
                return found
    return None
