"""The CPU rasterizer: kernels compiled by numba, with a hand-derived backward pass."""

import subprocess
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from subprocess import DEVNULL

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.reporting import say
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.kit.children import PYTHON
from edit3r.kit.compute.compiling import is_kept
from edit3r_rasterizers.compositing import (
    BACKWARD_SCRATCH,
    FORWARD_SCRATCH,
    differentiate_tiles,
    shade_tiles,
)
from edit3r_rasterizers.kernels import (
    aligned_empty,
    even_bounds,
    run_slices,
    scratch,
    thread_count,
)
from edit3r_rasterizers.layout import (
    CAMERA,
    POSE,
    RECORD,
    SUMS,
    CameraImages,
    GaussianArrays,
)
from edit3r_rasterizers.projection import PROJECTION_SCRATCH, pack_cameras, project
from edit3r_rasterizers.projection_backward import (
    PROJECTION_BACKWARD_SCRATCH,
    project_backward,
)
from edit3r_rasterizers.settings import (
    RasterizerSettings,
    check_cameras,
    check_finite,
    resolve_background,
)
from edit3r_rasterizers.tile_lists import TileGrid, TileLists, list_tiles

SHARES = 16
"""Gradients by the camera are summed in slices as for this many threads, however many there are:
other slices would give other last bits.
"""
MAX_WAIT = 120  # for kernels that another process compiles [s]


class NumbaSettings(RasterizerSettings):
    """The shared settings, and the number of threads."""

    threads: int = Field(0, ge=0, le=256)
    """CPU threads; 0: as many as torch and numba are set to use."""


class NumbaRasterizer(Rasterizer):
    """Renders float32 Gaussians on the CPU, with the same bits for any number of threads.

    float64 is computed from float32 copies and returned as float64; another device is refused.
    Differentiable in the cameras too: in `c2w` but its last row, taking the entries of its rotation
    one by one, and in focal lengths and principal point.
    """

    Settings = NumbaSettings
    settings: NumbaSettings

    def prepare(self, device: str) -> None:
        """Compile the kernels in another process, once after an install."""
        _compiling_ahead.start()

    def render(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        background: Float[Tensor, "*#batch_camera 3"] | None = None,
    ) -> Rendering:
        """Render; `background` (anything that broadcasts to `[B, C, 3]`, differentiable) replaces
        the setting.

        Raises InputError for input that is not finite or not on the CPU.
        """
        _check_device(gaussians)
        check_cameras(gaussians, cameras)
        _compiling_ahead.wait()
        single = gaussians.to(torch.float32)
        backgrounds = resolve_background(
            background, self.settings.background, single, cameras
        )
        outputs = _Rasterize.apply(
            self.settings,
            self.settings.near_planes(single),
            cameras.image_size,
            backgrounds,
            pack_cameras(cameras),
            *(getattr(single, name) for name in GaussianArrays._fields),
        )
        return Rendering(*outputs).to(gaussians.means.dtype)


class _CompilingAhead:
    """A process that compiles the kernels into numba's cache while the run's other steps work."""

    process: subprocess.Popen | None = None

    def start(self) -> None:
        if self.process is not None or is_kept(differentiate_tiles):
            return
        message = "the rasterizer, once after an install, beside the other steps"
        say("compiling", message)
        command = [*PYTHON, "-m", "edit3r_rasterizers.compile_ahead"]
        self.process = subprocess.Popen(
            command, stdin=DEVNULL, stdout=DEVNULL, stderr=DEVNULL
        )

    def wait(self) -> None:
        """Wait for the process; what it did not compile is compiled here."""
        if self.process is not None:
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(MAX_WAIT)
            self.process = None


_compiling_ahead = _CompilingAhead()


def _check_device(gaussians: Gaussians) -> None:
    device = gaussians.means.device
    if device.type != "cpu":
        raise InputError(
            f"rasterizer 'numba' renders on the CPU, the Gaussians are on {device}; "
            f"use 'gsplat' or 'torch' there, or move the Gaussians with .to('cpu')."
        )


@dataclass(frozen=True)
class ProjectedScene:
    """What `project_scene` prepares for drawing, and the forward pass for the backward one."""

    settings: NumbaSettings
    grid: TileGrid
    camera: np.ndarray  # see layout.CAMERA
    records: np.ndarray  # [G, RECORD]
    lists: TileLists
    transmittances: np.ndarray  # [H, W], filled by `draw`
    touched: np.ndarray  # [E], blocks that each entry reaches, filled by `draw`

    @property
    def tiles(self) -> tuple:
        """What the kernels of tiles are given of it: columns, lists and limits."""
        lists = self.lists.offsets, self.lists.entries, self.records, self.touched
        chosen = self.settings
        limits = np.log2(chosen.min_alpha), chosen.max_alpha, chosen.min_transmittance
        return self.grid.columns, lists, tuple(map(np.float32, limits))


class _Rasterize(torch.autograd.Function):
    """Renders B scenes with C cameras each, one after the other, and differentiates that."""

    @staticmethod
    def forward(ctx, settings, nears, image_size, backgrounds, cameras, *fields):
        batch, count = cameras.shape[:2]
        grid, learns = TileGrid(*image_size), any(ctx.needs_input_grad)
        size = batch, count, 1, grid.height, grid.width
        images = torch.empty(batch, count, 3, grid.height, grid.width)
        alphas, depths = torch.empty(size), torch.empty(size)
        threads, frames = thread_count(settings.threads), []
        scenes = [
            GaussianArrays(*(_array(field[b]) for field in fields))
            for b in range(batch)
        ]
        for b, c in product(range(batch), range(count)):
            near = settings.model_copy(update={"near_plane": nears[b]})
            camera = _array(cameras[b, c])
            shown = _images_of((images, alphas, depths), b, c)
            frame = project_scene(near, threads, scenes[b], camera, grid, learns)
            if frame is None:
                check_finite(Gaussians(*(field.detach() for field in fields)))
            draw(threads, frame, _array(backgrounds[b, c]), shown)
            frames += [frame] if learns else []
        ctx.scenes, ctx.frames = scenes, frames
        ctx.save_for_backward(images, alphas, depths)
        return images, alphas, depths

    @staticmethod
    def backward(ctx, *gradients):
        outputs = ctx.saved_tensors
        batch, count = outputs[0].shape[:2]
        by_background, *by_shapes, by_colours = ctx.needs_input_grad[3:]
        by_scenes = [GaussianArrays(*map(np.zeros_like, scene)) for scene in ctx.scenes]
        by_backgrounds = torch.zeros(batch, count, 3) if by_background else None
        by_cameras = torch.zeros(batch, count, CAMERA, dtype=torch.float64)
        for index, frame in enumerate(ctx.frames):
            b, c = divmod(index, count)
            seen, by_seen = _images_of(outputs, b, c), _images_of(gradients, b, c)
            if any(by_shapes) or by_colours:
                wanted = (
                    by_scenes[b],
                    by_cameras[b, c].numpy() if by_shapes[0] else None,
                )
                shapes = any(by_shapes)
                differentiate(ctx.scenes[b], frame, seen, by_seen, *wanted, shapes)
            if by_background:
                left = torch.from_numpy(frame.transmittances).double()
                by_image = gradients[0][b, c].double()
                by_backgrounds[b, c] = torch.einsum("chw,hw->c", by_image, left)
        stacked = [_stack(arrays) for arrays in zip(*by_scenes)] or [None] * 5
        pairs = zip(stacked, ctx.needs_input_grad[5:])
        by_fields = [field if wanted else None for field, wanted in pairs]
        return None, None, None, by_backgrounds, by_cameras, *by_fields


def _stack(arrays: tuple[np.ndarray, ...]) -> Tensor:
    """A tensor with one array for each scene, without a copy where there is one scene."""
    return torch.from_numpy(arrays[0][None] if len(arrays) == 1 else np.stack(arrays))


def _images_of(
    outputs: tuple[Tensor, Tensor, Tensor], scene: int, camera: int
) -> CameraImages:
    """Return one camera's images, as views of the tensors' memory where that is contiguous."""
    image, alpha, depth = (_array(output[scene, camera]) for output in outputs)
    return CameraImages(image, alpha[0], depth[0])


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def project_scene(
    settings: NumbaSettings,
    threads: int,
    scene: GaussianArrays,
    camera: np.ndarray,
    grid: TileGrid,
    by_splat: bool = True,
) -> ProjectedScene | None:
    """Compute the records and tile lists of one camera; returns None when a Gaussian is not finite.

    `by_splat`: also list the entries of each splat, which the backward pass needs.
    """
    count = len(scene.means)
    records = aligned_empty((count, RECORD))
    boxes, keys = np.empty((count, 4), np.uint16), np.empty(count, np.float32)
    size = float(grid.width), float(grid.height)
    depths = settings.near_plane, settings.far_plane
    sound = run_slices(
        project,
        even_bounds(count, threads),
        threads,
        scene,
        camera,
        (*size, *depths, settings.eps2d, settings.min_alpha),
        scratch(PROJECTION_SCRATCH, np.float64),
        records,
        boxes,
        keys,
    )
    if not all(sound):
        return None
    lists = list_tiles(threads, grid, records, boxes, keys, by_splat)
    touched = np.empty(len(lists.entries), np.uint16)
    left = np.empty((grid.height, grid.width), np.float32)
    return ProjectedScene(settings, grid, camera, records, lists, left, touched)


def draw(
    threads: int, frame: ProjectedScene, background: np.ndarray, images: CameraImages
) -> None:
    """Fill `images` over a background colour [3]."""
    run_slices(
        shade_tiles,
        _tile_bounds(frame, threads),
        threads,
        *frame.tiles,
        background,
        scratch(FORWARD_SCRATCH, np.float32),
        images,
        frame.transmittances,
    )


def differentiate(
    scene: GaussianArrays,
    frame: ProjectedScene,
    images: CameraImages,
    image_gradients: CameraImages,
    by_scene: GaussianArrays,
    by_camera: np.ndarray | None,
    shapes: bool,
) -> None:
    """Add the gradients of one camera's images to those of the scene.

    Without `shapes` only those by the harmonics, for which colours alone matter. `by_camera`
    [CAMERA], which needs `shapes`, gets the gradient by the packed camera.
    """
    threads = thread_count(frame.settings.threads)
    sums = aligned_empty((len(frame.lists.positions) * SUMS,))
    run_slices(
        differentiate_tiles,
        _tile_bounds(frame, threads),
        threads,
        *frame.tiles,
        shapes,
        scratch(BACKWARD_SCRATCH, np.float32),
        images,
        frame.transmittances,
        image_gradients,
        sums,
    )
    parts = run_slices(
        project_backward,
        even_bounds(len(scene.means), threads if by_camera is None else SHARES),
        threads,
        scene,
        frame.camera,
        frame.settings.eps2d,
        frame.records,
        (frame.lists.splat_offsets, frame.lists.positions),
        sums,
        shapes,
        scratch(PROJECTION_BACKWARD_SCRATCH, np.float64),
        scratch(8, np.uint64),
        None if by_camera is None else lambda: np.zeros((POSE, 8)),
        by_scene,
    )
    if by_camera is not None:
        by_camera[:POSE] = sum(part.sum(1) for part in parts)


def _tile_bounds(frame: ProjectedScene, threads: int) -> list[int]:
    """Cut the tiles into slices with about equal numbers of entries."""
    if threads == 1:
        return [0, frame.grid.count]
    slices = min(frame.grid.count, 8 * threads)
    # opening a tile costs as much as some entries
    work = frame.lists.offsets + 16 * np.arange(frame.grid.count + 1)
    cuts = np.searchsorted(work, work[-1] * np.arange(1, slices) / slices)
    return [
        0,
        *np.unique(cuts[(cuts > 0) & (cuts < frame.grid.count)]).tolist(),
        frame.grid.count,
    ]
