"""A run's images and cameras as programs read them that make scenes of photos: COLMAP's model, and
nerfstudio's `transforms.json`.

Both have the centre of the top-left pixel at (0.5, 0.5), as `cameras.json` has.
"""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import warn
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.files.atomic import atomic_folder
from edit3r.kit.geometry.cameras import invert_rigid, to_pixels
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.rotations import matrices_to_quats
from edit3r.kit.photos.cameras import read_cameras, read_scene_cameras, write_transforms
from edit3r.kit.photos.images import read_image, save_pixels, unique_names

MAX_POINTS = 100_000  # as many as COLMAP finds in some hundred photos
_PINHOLE = 1  # COLMAP's number of the model with fx, fy, cx, cy
_POINT = [
    ("id", "<u8"),
    ("position", "<f8", 3),
    ("colour", "u1", 3),
    ("error", "<f8"),
    ("track_length", "<u8"),
]


def export_cameras(
    out: str | Path,
    run: str | Path,
    gaussians: Gaussians,
    form: str,
    overwrite: bool = False,
) -> None:
    """Write the views of the run in folder `run` as one of `CAMERA_FORMATS`, a folder `out`.

    `out/images` holds the edited images, which the scene shows. COLMAP's model in `out/sparse/0`
    has means of the scene (batch 1) as points, without tracks. Raises InputError where the run has
    no cameras or no images.
    """
    cameras_file = Path(run) / "cameras.json"
    if not cameras_file.is_file():
        raise InputError(
            f"{run}: holds no cameras.json; {form} is written of the folder of a run."
        )
    cameras, views = read_scene_cameras(cameras_file)
    without_pose = {view.file for view in read_cameras(cameras_file)}
    without_pose -= {view.file for view in views}
    if without_pose:
        told = ", ".join(sorted(without_pose))
        warn(f"{told}: without a pose in cameras.json, so not in the {form} export.")
    # The folder may come from a stranger.
    stems = unique_names([Path(view.file).stem for view in views])
    names = [f"{stem}.png" for stem in stems]
    with atomic_folder(out, overwrite) as folder:
        (folder / "images").mkdir()
        for view, name in zip(views, names):
            image = _image_of(Path(run), Path(view.file).name, cameras.image_size)
            save_pixels(np.asarray(image), folder / "images" / name)
        if form == "nerfstudio":
            files = [f"images/{name}" for name in names]
            write_transforms(folder / "transforms.json", cameras, files)
        else:
            _write_colmap(folder / "sparse" / "0", cameras, names, gaussians)


def _image_of(run: Path, name: str, size: tuple[int, int]) -> Image.Image:
    """The edited image of a view, or its photo where nothing was edited."""
    for folder in ("edited", "inputs"):
        path = run / folder / name
        if path.is_file():
            image = read_image(path)
            if image.size != size[::-1]:
                raise InputError(
                    f"{path}: has another size than the first camera of cameras.json."
                )
            return image
    raise InputError(
        f"{run}: has no image {name}; repeat the run with `--outputs scene,images`."
    )


def _write_colmap(
    folder: Path, cameras: Cameras, names: Sequence[str], gaussians: Gaussians
) -> None:
    """COLMAP's binary model, whose images may have spaces in their names."""
    folder.mkdir(parents=True)
    height, width = cameras.image_size
    pixels = to_pixels(cameras.intrinsics[0].double(), cameras.image_size).tolist()
    poses = invert_rigid(cameras.c2w[0].double())
    turns = matrices_to_quats(poses[:, :3, :3]).tolist()
    places = poses[:, :3, 3].tolist()
    lenses = images = struct.pack("<Q", len(names))
    for index, ((fx, _, cx), (_, fy, cy), _) in enumerate(pixels):
        key = index + 1
        lenses += struct.pack("<Ii2Q4d", key, _PINHOLE, width, height, fx, fy, cx, cy)
        images += struct.pack("<I7dI", key, *turns[index], *places[index], key)
        images += names[index].encode() + b"\0" + struct.pack("<Q", 0)  # no matches
    (folder / "cameras.bin").write_bytes(lenses)
    (folder / "images.bin").write_bytes(images)

    step = gaussians.count // MAX_POINTS + 1
    means = gaussians.means[0, ::step].numpy()
    colours = dc_to_colour(gaussians.harmonics[0, ::step, 0]).clamp(0, 1)
    points = np.zeros(len(means), _POINT)
    points["id"] = np.arange(1, len(means) + 1)
    points["position"] = means
    points["colour"] = (colours * 255).round().byte().numpy()
    content = struct.pack("<Q", len(points)) + points.tobytes()
    (folder / "points3D.bin").write_bytes(content)
