"""Reconstructor `program`: photos in, scene.ply and cameras.json out, by any command."""

import shlex
import subprocess
import tempfile
from pathlib import Path

import torch
from pydantic import Field

import edit3r
from edit3r.contract import settings as config
from edit3r.contract.errors import RunError
from edit3r.contract.interfaces import Geometry, Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit.photos.camera_files import read_scene_cameras
from edit3r.kit.photos.images import save_image
from edit3r.kit.scenes.ply import load_ply


class ProgramReconstructor(Reconstructor):
    """The program gets 000.png, 001.png, ... and writes both files in the frame of the first
    photo's camera.
    """

    class Settings(edit3r.Settings):
        command: str = Field(
            "",
            description="such as 'mytool {photos} {result}': two folders; no shell is involved",
            json_schema_extra=config.USER_ONLY,
        )
        timeout: float = Field(
            3600, gt=0, description="time limit of one scene [seconds]"
        )

    settings: Settings

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: Geometry | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        scenes, cameras = zip(*(self._scene(images) for images in views.images))
        c2w, intrinsics = (
            torch.cat([getattr(one, name) for one in cameras])
            for name in ("c2w", "intrinsics")
        )
        made = Reconstruction(
            Gaussians.stack(scenes), Cameras(c2w, intrinsics, views.image_size)
        )
        return made.to(views.images)

    def _scene(self, images: torch.Tensor) -> tuple[Gaussians, Cameras]:
        with tempfile.TemporaryDirectory() as folder:
            photos, result = Path(folder, "photos"), Path(folder, "result")
            photos.mkdir(), result.mkdir()
            for index, image in enumerate(images):
                save_image(image, photos / f"{index:03}.png")
            command = [
                word.format(photos=photos, result=result)
                for word in shlex.split(self.settings.command)
            ]
            try:
                subprocess.run(
                    command,
                    check=True,
                    capture_output=True,
                    text=True,
                    timeout=self.settings.timeout,
                )
            except (OSError, IndexError, subprocess.SubprocessError) as error:
                said = (
                    (getattr(error, "stderr", "") or str(error))
                    .strip()
                    .splitlines()[-1:]
                )
                raise RunError(
                    f"reconstructor.command {self.settings.command!r} failed: {' '.join(said)}"
                ) from None
            gaussians, (cameras, _) = (
                load_ply(result / "scene.ply"),
                read_scene_cameras(result / "cameras.json"),
            )
        if cameras.count != len(images) or not torch.allclose(
            cameras.c2w[0, 0], torch.eye(4), atol=1e-4
        ):
            raise RunError(
                "cameras.json: expected one camera for each photo, the first of them at the "
                "identity."
            )
        return gaussians, cameras
