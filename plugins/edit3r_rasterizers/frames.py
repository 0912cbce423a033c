"""One scene through one camera: which kernels run, over what, forward and backward."""

from dataclasses import dataclass

import numpy as np

from edit3r_rasterizers.memory import aligned_empty, scratch
from edit3r_rasterizers.projection import PROJECTION_SCRATCH, project
from edit3r_rasterizers.projection_backward import PROJECTION_BACKWARD_SCRATCH, project_backward
from edit3r_rasterizers.raster_backward import BACKWARD_SCRATCH, differentiate_tiles
from edit3r_rasterizers.raster_forward import FORWARD_SCRATCH, shade_tiles
from edit3r_rasterizers.records import RECORD, SUMS, TileGrid
from edit3r_rasterizers.settings import RasterizerSettings
from edit3r_rasterizers.threads import even_bounds, run_slices
from edit3r_rasterizers.tile_lists import TileLists, list_tiles
from edit3r_rasterizers.tiles import BATCH


@dataclass(frozen=True)
class Scene:
    """One scene's Gaussians, or their gradients, as the kernels read them: contiguous float32 arrays."""

    means: np.ndarray  # [G, 3]
    scales: np.ndarray  # [G, 3]
    quats: np.ndarray  # [G, 4]
    opacities: np.ndarray  # [G]
    harmonics: np.ndarray  # [G, K, 3]

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        return self.means, self.scales, self.quats, self.opacities, self.harmonics

    def zeros_like(self) -> "Scene":
        return Scene(*(np.zeros_like(array) for array in self.arrays))


@dataclass(frozen=True)
class Pictures:
    """What a camera sees, or the gradient by it."""

    image: np.ndarray  # [3, H, W]
    alpha: np.ndarray  # [H, W]
    depth: np.ndarray  # [H, W]


@dataclass(frozen=True)
class Frame:
    """What `project_scene` prepares for drawing, and the forward pass leaves for the backward pass."""

    grid: TileGrid
    camera: np.ndarray  # see records.CAMERA
    records: np.ndarray  # [G, RECORD]
    lists: TileLists
    transmittances: np.ndarray  # [H, W], filled by `draw`


def project_scene(
    settings: RasterizerSettings, threads: int, scene: Scene, camera: np.ndarray, grid: TileGrid
) -> Frame | None:
    """Records and tile lists of one camera; None when a Gaussian is not finite."""
    count = len(scene.means)
    records = aligned_empty((count, RECORD))
    boxes, keys = np.empty((count, 4), np.uint16), np.empty(count, np.float32)
    limits = (float(grid.width), float(grid.height), settings.near, settings.far, settings.eps2d, settings.min_alpha)
    work = scratch(PROJECTION_SCRATCH, np.float64)
    sound = run_slices(
        project, even_bounds(count, threads), threads, *scene.arrays, camera, *limits, work, records, boxes, keys
    )
    if not all(sound):
        return None
    lists = list_tiles(threads, grid, records, boxes, keys)
    return Frame(grid, camera, records, lists, np.empty((grid.height, grid.width), np.float32))


def draw(settings: RasterizerSettings, threads: int, frame: Frame, background: np.ndarray, pictures: Pictures) -> None:
    """Fill `pictures` over a background colour [3]."""
    run_slices(
        shade_tiles,
        _tile_bounds(frame, threads),
        threads,
        *_tile_arguments(settings, frame),
        background,
        scratch(FORWARD_SCRATCH, np.float32),
        scratch(int(BATCH), np.uint64),
        pictures.image,
        pictures.alpha,
        pictures.depth,
        frame.transmittances,
    )


def differentiate(
    settings: RasterizerSettings,
    threads: int,
    scene: Scene,
    frame: Frame,
    pictures: Pictures,
    by_pictures: Pictures,
    by_scene: Scene,
) -> None:
    """Add the gradients of one camera's pictures to those of the scene."""
    sums = aligned_empty((len(frame.lists.positions) * SUMS,))
    run_slices(
        differentiate_tiles,
        _tile_bounds(frame, threads),
        threads,
        *_tile_arguments(settings, frame),
        scratch(BACKWARD_SCRATCH, np.float32),
        scratch(int(BATCH), np.uint64),
        pictures.image,
        pictures.depth,
        frame.transmittances,
        by_pictures.image,
        by_pictures.alpha,
        by_pictures.depth,
        sums,
    )
    run_slices(
        project_backward,
        even_bounds(len(scene.means), threads),
        threads,
        *scene.arrays,
        frame.camera,
        settings.eps2d,
        frame.records,
        frame.lists.places,
        frame.lists.positions,
        sums,
        scratch(PROJECTION_BACKWARD_SCRATCH, np.float64),
        scratch(8, np.uint64),
        *by_scene.arrays,
    )


def _tile_arguments(settings: RasterizerSettings, frame: Frame) -> tuple:
    limits = settings.max_alpha, settings.min_alpha, settings.min_transmittance
    return frame.grid.columns, frame.lists.offsets, frame.lists.entries, frame.records, *limits


def _tile_bounds(frame: Frame, threads: int) -> list[int]:
    """Slices of tiles with about equal numbers of entries."""
    if threads == 1:
        return [0, frame.grid.count]
    slices = min(frame.grid.count, 8 * threads)
    work = frame.lists.offsets + 16 * np.arange(frame.grid.count + 1)  # opening a tile costs as much as some entries
    cuts = np.searchsorted(work, work[-1] * np.arange(1, slices) / slices)
    return [0, *np.unique(cuts[(cuts > 0) & (cuts < frame.grid.count)]).tolist(), frame.grid.count]
