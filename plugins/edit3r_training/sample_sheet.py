"""One picture that shows what the network does with held-out scenes."""

from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from edit3r_training.batches import TrainingBatch
from edit3r_training.supervision import PixelMaps


def save_sample_sheet(path: Path, maps: PixelMaps, batch: TrainingBatch, rows: int = 6) -> None:
    """A row a scene: reference photo and edit, second photo and its own edit, its truth, its colours as predicted,
    true, matched and predicted inverse depth."""
    lines = []
    for scene in range(min(rows, len(batch.truth))):
        last = batch.truth.shape[1] - 1
        pictures = [
            batch.source.images[scene, 0],
            batch.edited.images[scene, 0],
            batch.source.images[scene, last],
            batch.edited.images[scene, last],
            batch.truth[scene, last],
            maps.colours[scene, last],
        ]
        if batch.depths is not None and batch.geometry is not None:
            shown = (batch.depths, batch.geometry.depths, maps.depths)
            pictures += [_inverse_depth(d[scene, last], batch.depths[scene, last]) for d in shown]
        lines.append(torch.cat(pictures, -1))
    sheet = torch.cat(lines, -2).clamp(0, 1).permute(1, 2, 0)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((sheet.cpu().numpy() * 255).round().astype("uint8")).save(path)


def _inverse_depth(depths: Tensor, truth: Tensor) -> Tensor:
    inverse = 1 / depths.clamp(min=1e-6)
    top = (1 / truth).max()
    return (inverse / top).clamp(0, 1).expand(3, -1, -1)
