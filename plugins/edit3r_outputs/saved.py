"""A saved scene, in the folder of a run or a file alone, written by any writer."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from edit3r import Registry
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Rasterizer, SceneToWrite, Writer
from edit3r.contract.reporting import warn
from edit3r.contract.types import Cameras, Gaussians, Rendering, Views
from edit3r.kit import asking
from edit3r.kit.files.atomic import atomic_folder, atomic_write
from edit3r.kit.files.names import unique_names
from edit3r.kit.photos.camera_files import PosedCamera, read_cameras, read_scene_cameras
from edit3r.kit.photos.images import read_image
from edit3r.kit.rendering import Flight, path_around, render_each
from edit3r.kit.scenes.look import camera_file_of, look_at
from edit3r.kit.scenes.reading import load_scene
from edit3r.running import RunConfig, RunFolder


class SavedScene:
    """A scene's file and what lies beside it; read when a writer needs it."""

    def __init__(self, file: Path, registry: Registry) -> None:
        self.file = file
        self._registry = registry

    @cached_property
    def gaussians(self) -> Gaussians:
        return load_scene(self.file)

    @property
    def stem(self) -> str:
        """The name of the file without its suffix."""
        if self.file.suffix == ".ply":
            return self.file.name.removesuffix(".ply").removesuffix(".compressed")
        return self.file.stem

    def for_writer(self, writer: Writer) -> SceneToWrite:
        """What the writer needs of the scene. Raises InputError for what is not there."""
        needed: dict[str, Any] = {name: getattr(self, name) for name in writer.needs}
        if "cameras" in needed:
            folder = RunFolder(self.file.parent)
            needed |= {"names": self.names, "up": folder.up, "unit": folder.unit}
        return SceneToWrite(
            **{"title": self.stem, **needed, "gaussians": self.gaussians}
        )

    @cached_property
    def _posed(self) -> tuple[Cameras, list[PosedCamera]]:
        file = camera_file_of(self.file)
        if file is None:
            return look_at(self.file, None, self.gaussians)
        cameras, views = read_scene_cameras(file)
        without = {view.file for view in read_cameras(file)}
        without -= {view.file for view in views}
        if without:
            names = ", ".join(sorted(without))
            warn(f"{names}: without a pose in {file.name}, so left out.")
        return cameras, views

    @property
    def cameras(self) -> Cameras:
        return self._posed[0]

    @cached_property
    def names(self) -> tuple[str, ...]:
        # The folder may come from a stranger.
        return tuple(unique_names([Path(view.file).stem for view in self._posed[1]]))

    @cached_property
    def photos(self) -> Views:
        return self._views("inputs")

    @cached_property
    def edited(self) -> Views:
        """The edited images, and photos where nothing was edited."""
        return self._views("edited", "inputs")

    def _views(self, *folders: str) -> Views:
        if camera_file_of(self.file) is None:
            raise InputError(
                f"{self.file.parent}: holds no cameras.json; this writer needs the folder of a "
                "run."
            )
        cameras, views = self._posed
        images = [self._image(Path(view.file).name, folders) for view in views]
        pixels = torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2)
        return Views(pixels.float()[None] / 255, cameras.intrinsics, self.names)

    def _image(self, name: str, folders: tuple[str, ...]) -> np.ndarray:
        """The image of a view in the first of the folders that has it."""
        for folder in folders:
            path = self.file.parent / folder / name
            if path.is_file():
                image = read_image(path)
                if image.size != self.cameras.image_size[::-1]:
                    raise InputError(
                        f"{path}: has another size than the first camera of cameras.json."
                    )
                return np.array(image)
        raise InputError(
            f"{self.file.parent}: has no image {name}; this writer needs the folder of a run with "
            "its images (`--outputs scene,images`)."
        )

    @cached_property
    def _rasterizer(self) -> Rasterizer:
        return self._registry.build_choice("rasterizer", RunConfig().rasterizer)

    def render(self, cameras: Cameras) -> Rendering:
        return render_each(
            self._rasterizer, self.gaussians, cameras, "look at the scene"
        )

    @cached_property
    def rendered(self) -> Rendering:
        return self.render(self.cameras)

    @property
    def frames(self) -> Flight:
        path = path_around(self.cameras, self.rendered, RunConfig().frames)
        return Flight(self._rasterizer, self.gaussians, path)


@torch.no_grad()
def write_saved(
    writer: Writer, path: Path, saved: SavedScene, overwrite: bool = False
) -> None:
    """Write a saved scene to `path`, where it appears whole or not at all."""
    scene = saved.for_writer(writer)
    with _in_place(writer, path, overwrite) as partial:
        asking.write(writer, partial, scene)


@contextmanager
def _in_place(writer: Writer, path: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a path where nothing is, of which the file or folder then becomes `path`."""
    if writer.offer.component.makes_folder:
        with atomic_folder(path, overwrite) as partial:
            partial.rmdir()
            yield partial
    else:
        with atomic_write(path) as partial:
            partial.unlink()
            yield partial
