"""What is drawn over a finished scene: which Gaussians it chooses, and a file that keeps it."""

import json
from contextlib import suppress
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from edit3r_objects.api import Drawn, choose_drawn, read_drawn
from jaxtyping import Bool
from torch import Tensor

from edit3r import Registry
from edit3r.contract.errors import InputError
from edit3r.contract.types import Gaussians
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.files.text import read_json
from edit3r.kit.scenes.axes import LEAST_OPACITY
from edit3r.kit.scenes.ply import load_ply
from edit3r_app.jobs import JobsFolder

DRAWN = "drawn.json"
MOST_GROWN = 20  # steps


class Drawing:
    """Answers strokes over the scenes of a folder; the last two scenes stay loaded."""

    def __init__(self, folder: JobsFolder, registry: Registry) -> None:
        self.folder = folder
        self.registry = registry
        self._scene = lru_cache(maxsize=2)(self._load)

    def change(self, run: str, asked: dict[str, Any]) -> dict[str, Any]:
        """Add a stroke, take the last one back, grow, or clear; returns what is chosen then."""
        strokes, grown = self._kept(run)
        do, value = str(asked.get("do", "")), asked.get("value")
        if do == "stroke":
            strokes = [*strokes, *read_drawn([value])]
        elif do == "grow":
            step = 1 if value == 1 else -1
            grown = max(-MOST_GROWN, min(MOST_GROWN, grown + step))
        elif do == "undo":
            strokes, grown = (strokes, 0) if grown else (strokes[:-1], 0)
        elif do == "clear":
            strokes, grown = [], 0
        elif do != "look":
            raise InputError(f"{do[:40]!r}: no such change of what is drawn.")
        self._keep(run, strokes, grown)
        return self._told(run, strokes, grown)

    def file(self, run: str) -> Path:
        """The file of what is drawn, for `edit3r objects`. Raises InputError where nothing is."""
        if not self.is_drawn(run):
            raise InputError("draw around something in the scene first.")
        return self.folder.beside(run) / DRAWN

    def is_drawn(self, run: str) -> bool:
        return bool(self._kept(run)[0])

    def _told(self, run: str, strokes: list[Drawn], grown: int) -> dict[str, Any]:
        told = {"strokes": len(strokes), "grown": grown, "count": 0, "bits": ""}
        if not strokes:
            return told
        gaussians = self._scene(run)
        rasterizer = self.registry.build("rasterizer", "auto")
        with torch.no_grad():
            chosen = choose_drawn(gaussians, strokes, rasterizer, grown)
        return told | {
            "count": int(chosen.sum()),
            "bits": self._bits(gaussians, chosen),
        }

    def _bits(self, gaussians: Gaussians, chosen: Bool[Tensor, "gaussian"]) -> str:
        """One bit, as hexadecimal digits, for each Gaussian that the viewer's page holds."""
        shown = gaussians.opacities[0] >= LEAST_OPACITY
        return np.packbits(chosen[shown].numpy()).tobytes().hex()

    def _load(self, run: str) -> Gaussians:
        scene = self.folder.path(run) / "scene.ply"
        if not scene.is_file():
            raise InputError("there is no scene to draw on yet.")
        return load_ply(scene, visible=True)

    def _kept(self, run: str) -> tuple[list[Drawn], int]:
        self.folder.path(run)
        with suppress(OSError, InputError, ValueError, KeyError, TypeError):
            content = read_json(self.folder.beside(run) / DRAWN)
            return list(read_drawn(content["strokes"])), int(content["grown"])
        return [], 0

    def _keep(self, run: str, strokes: list[Drawn], grown: int) -> None:
        content = {"strokes": [asdict(one) for one in strokes], "grown": grown}
        with atomic_write(self.folder.beside(run) / DRAWN) as partial:
            partial.write_text(json.dumps(content), encoding="utf-8")
