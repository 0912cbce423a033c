"""One picture to look at first: photo, 2D edit and 3D result of each view."""

from pathlib import Path

import numpy as np

from edit3r.contract.interfaces import SceneToWrite, Writer
from edit3r.kit.contact_sheet import (
    draw_sheet,
    images_of,
    outlined_views,
    with_candidates,
)
from edit3r.kit.photos.images import save_pixels


class SheetWriter(Writer):
    """The views side by side, with the outline of what was to be edited."""

    needs = ("photos", "edited", "rendered")

    def write(self, path: Path, scene: SceneToWrite) -> None:
        photos, edited, rendered = scene.photos, scene.edited, scene.rendered
        assert photos is not None and edited is not None  # they are needed
        assert rendered is not None
        columns = {
            "photo": outlined_views(images_of(photos), scene.masks),
            "2D edit": images_of(edited),
            "3D result": images_of(rendered),
        }
        sheet = draw_sheet(
            columns,
            names=scene.names,
            title=scene.title or "no prompt",
            subtitle=scene.about,
        )
        picture = np.asarray(with_candidates(sheet, scene.candidates))
        save_pixels(picture, path, is_photo=False)
