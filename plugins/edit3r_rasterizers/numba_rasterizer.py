"""The CPU rasterizer: projection, binning and blending compiled by numba, with a hand-derived backward pass."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.errors import InputError
from edit3r.interfaces import Rasterizer
from edit3r.types import Cameras, Gaussians, Rendering
from edit3r_rasterizers.checks import check_cameras, check_finite, resolve_background
from edit3r_rasterizers.memory import aligned_empty, scratch
from edit3r_rasterizers.projection import PROJECTION_SCRATCH, project
from edit3r_rasterizers.projection_backward import PROJECTION_BACKWARD_SCRATCH, project_backward
from edit3r_rasterizers.raster_backward import BACKWARD_SCRATCH, differentiate_tiles
from edit3r_rasterizers.raster_forward import FORWARD_SCRATCH, shade_tiles
from edit3r_rasterizers.records import RECORD, SUMS, TileGrid, pack_camera
from edit3r_rasterizers.settings import BORDER, RasterizerSettings
from edit3r_rasterizers.threads import even_bounds, run_slices, thread_count
from edit3r_rasterizers.tile_lists import TileLists, list_tiles
from edit3r_rasterizers.tiles import BATCH


class NumbaSettings(RasterizerSettings):
    """The shared settings, and the number of threads."""

    threads: int = Field(0, ge=0, le=256, description="CPU threads; 0: as many as torch and numba are set to use.")


class NumbaRasterizer(Rasterizer):
    """Renders float32 Gaussians on the CPU; the same bits for any number of threads.

    float64 is computed from float32 copies and returned as float64; another device is refused. Cameras get no
    gradient: use `torch` to differentiate poses.
    """

    Settings = NumbaSettings

    def __init__(self, settings: NumbaSettings) -> None:
        self.settings = settings

    def render(
        self, gaussians: Gaussians, cameras: Cameras, background: Float[Tensor, "*#batch_camera 3"] | None = None
    ) -> Rendering:
        """Render; `background` (anything that broadcasts to `[B, C, 3]`, differentiable) replaces the setting.

        Raises InputError for input that is not finite or not on the CPU, or for cameras that ask for a gradient.
        """
        _check_device(gaussians)
        check_cameras(gaussians, cameras)
        if torch.is_grad_enabled() and (cameras.c2w.requires_grad or cameras.intrinsics.requires_grad):
            raise InputError("rasterizer 'numba' has no gradient for cameras; detach them, or use 'torch'.")
        dtype = gaussians.means.dtype
        backgrounds = resolve_background(background, self.settings.background, gaussians, cameras)
        fields = (
            gaussians.means,
            gaussians.scales,
            gaussians.quats,
            gaussians.opacities,
            gaussians.harmonics,
            backgrounds,
        )
        values = [field.to(torch.float32) for field in fields]
        outputs = _Rasterize.apply(self.settings, gaussians, cameras, *values)
        return Rendering(*(output.to(dtype) for output in outputs))


def _check_device(gaussians: Gaussians) -> None:
    device = gaussians.means.device
    if device.type != "cpu":
        raise InputError(
            f"rasterizer 'numba' renders on the CPU, the Gaussians are on {device}; "
            f"use 'gsplat' or 'torch' there, or move the Gaussians with .to('cpu')."
        )


@dataclass(frozen=True)
class _Scene:
    """One scene's Gaussians as the kernels read them: contiguous float32 arrays."""

    means: np.ndarray  # [G, 3]
    scales: np.ndarray  # [G, 3]
    quats: np.ndarray  # [G, 4]
    opacities: np.ndarray  # [G]
    harmonics: np.ndarray  # [G, K, 3]

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        return self.means, self.scales, self.quats, self.opacities, self.harmonics


@dataclass(frozen=True)
class _Frame:
    """What the forward pass of one camera leaves for its backward pass."""

    grid: TileGrid
    camera: np.ndarray  # see records.CAMERA
    records: np.ndarray  # [G, RECORD]
    lists: TileLists
    transmittances: np.ndarray  # [H, W]


class _Rasterize(torch.autograd.Function):
    """B scenes with C cameras each, one after the other."""

    @staticmethod
    def forward(ctx, settings, gaussians, cameras, means, scales, quats, opacities, harmonics, backgrounds):
        batch, count = cameras.c2w.shape[:2]
        height, width = cameras.image_size
        images = torch.empty(batch, count, 3, height, width)
        alphas, depths = torch.empty(batch, count, 1, height, width), torch.empty(batch, count, 1, height, width)
        threads = thread_count(settings.threads)
        tensors = means, scales, quats, opacities, harmonics
        scenes = [_Scene(*(_array(tensor[b]) for tensor in tensors)) for b in range(batch)]
        frames = []
        for b in range(batch):
            for c in range(count):
                pictures = [output[b, c].numpy() for output in (images, alphas, depths)]
                camera = pack_camera(cameras.c2w[b, c], cameras.intrinsics[b, c], TileGrid(height, width), BORDER)
                frame = _project_and_bin(settings, threads, scenes[b], camera, TileGrid(height, width))
                if frame is None:
                    check_finite(gaussians)
                _shade(settings, threads, frame, _array(backgrounds[b, c]), pictures)
                frames.append(frame)
        ctx.settings, ctx.scenes = settings, scenes
        ctx.frames = frames if any(ctx.needs_input_grad) else None
        ctx.save_for_backward(images, alphas, depths)
        ctx.set_materialize_grads(True)
        return images, alphas, depths

    @staticmethod
    def backward(ctx, *gradients):
        outputs = ctx.saved_tensors
        batch, count = outputs[0].shape[:2]
        threads = thread_count(ctx.settings.threads)
        totals = [[np.zeros_like(array) for array in scene.arrays] for scene in ctx.scenes]
        by_background = torch.zeros(batch, count, 3)
        for index, frame in enumerate(ctx.frames):
            b, c = divmod(index, count)
            pictures = [_array(output[b, c]) for output in outputs]
            by_pictures = [_array(gradient[b, c]) for gradient in gradients]
            _differentiate(ctx.settings, threads, ctx.scenes[b], frame, pictures, by_pictures, totals[b])
            seen = gradients[0][b, c] * torch.from_numpy(frame.transmittances)
            by_background[b, c] = seen.sum((1, 2), dtype=torch.float64)
        stacked = [torch.from_numpy(np.stack(arrays)) for arrays in zip(*totals)]
        return None, None, None, *stacked, by_background


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def _project_and_bin(
    settings: NumbaSettings, threads: int, scene: _Scene, camera: np.ndarray, grid: TileGrid
) -> _Frame | None:
    """The tile lists of one camera; None when a Gaussian is not finite."""
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
    transmittances = np.empty((grid.height, grid.width), np.float32)
    return _Frame(grid, camera, records, lists, transmittances)


def _shade(settings: NumbaSettings, threads: int, frame: _Frame, background: np.ndarray, pictures: list) -> None:
    image, alpha, depth = pictures
    run_slices(
        shade_tiles,
        _tile_bounds(frame, threads),
        threads,
        frame.grid.columns,
        frame.lists.offsets,
        frame.lists.entries,
        frame.records,
        settings.max_alpha,
        settings.min_alpha,
        settings.min_transmittance,
        background,
        scratch(FORWARD_SCRATCH, np.float32),
        scratch(int(BATCH), np.uint64),
        image,
        alpha[0],
        depth[0],
        frame.transmittances,
    )


def _differentiate(
    settings: NumbaSettings, threads: int, scene: _Scene, frame: _Frame, pictures: list, by_pictures: list, totals: list
) -> None:
    image, _, depth = pictures
    by_image, by_alpha, by_depth = by_pictures
    sums = aligned_empty((len(frame.lists.entries) * SUMS,))
    run_slices(
        differentiate_tiles,
        _tile_bounds(frame, threads),
        threads,
        frame.grid.columns,
        frame.lists.offsets,
        frame.lists.entries,
        frame.records,
        settings.max_alpha,
        settings.min_alpha,
        settings.min_transmittance,
        scratch(BACKWARD_SCRATCH, np.float32),
        scratch(int(BATCH), np.uint64),
        image,
        depth[0],
        frame.transmittances,
        by_image,
        by_alpha[0],
        by_depth[0],
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
        *totals,
    )


def _tile_bounds(frame: _Frame, threads: int) -> list[int]:
    """Slices of tiles with about equal numbers of entries."""
    if threads == 1:
        return [0, frame.grid.count]
    slices = min(frame.grid.count, 8 * threads)
    work = frame.lists.offsets + 16 * np.arange(frame.grid.count + 1)  # opening a tile costs as much as some entries
    cuts = np.searchsorted(work, work[-1] * np.arange(1, slices) / slices)
    return [0, *np.unique(cuts[cuts > 0]).tolist(), frame.grid.count]
