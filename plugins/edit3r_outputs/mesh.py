"""A scene as one surface of triangles, for programs that know no Gaussians."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from pydantic import Field
from scipy.spatial import cKDTree
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite, Writer
from edit3r.contract.types import Cameras, Rendering
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.warping import warp
from edit3r_outputs.mesh_ply import coloured_ply

# The numbers of this block: no figures kept.
CELLS = (216, 288, 160)  # of the usual grid: rows, columns, steps of inverse depth
WIDER = 1.3  # the grid's field of view than that of view 0
ROOM = 0.05  # of the range of inverse depths, before and behind it
OUTER = 0.005  # share of the pixels that may lie nearer or farther than the range
REACH = 8.0  # steps behind a surface up to which a view knows that it is solid
SMOOTH = 0.7  # standard deviation over which views' distances are averaged [cells]
KNOWN = 0.1  # smoothed number of views from which a cell is known
SOLID = 0.8  # alpha from which a view shows a surface
UPRIGHT = (1.0, -1.0, -1.0)  # from the frame of view 0 to y up, z backward, as in GLB

Volume = Float[Tensor, "row column step"]


@dataclass(frozen=True)
class Mesh:
    """Triangles in the frame of view 0."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    colours: Float[np.ndarray, "vertex 3"]  # sRGB in [0, 1]


@dataclass(frozen=True)
class Frustum:
    """A grid of rays through view 0's image and steps of inverse depth along them."""

    rays: Float[Tensor, "row column 3"]  # in world axes, camera z 1
    centre: Float[Tensor, "3"]
    inverse_depths: Float[Tensor, "step"]

    @property
    def step(self) -> float:
        return float(self.inverse_depths[1] - self.inverse_depths[0])


class MeshWriter(Writer):
    """The surface that the scene shows its cameras, as PLY."""

    needs = ("cameras", "render")

    class Settings(edit3r.Settings):
        detail: float = Field(1.0, gt=0.05, le=4)
        """how many times as fine as usual the grid is"""

    settings: Settings

    @torch.no_grad()
    def write(self, path: Path, scene: SceneToWrite) -> None:
        assert scene.cameras is not None and scene.render is not None  # they are needed
        shown = scene.render(scene.cameras)
        mesh = mesh_of(shown, scene.cameras, self.settings.detail)
        upright = mesh.vertices * np.array(UPRIGHT)
        colours = (mesh.colours * 255).round()
        path.write_bytes(coloured_ply(upright, colours, mesh.faces))


def mesh_of(shown: Rendering, cameras: Cameras, detail: float = 1.0) -> Mesh:
    """The surface of a scene (batch 1), of which its cameras are shown the rendering.

    Rendered depths become a truncated signed distance (Curless and Levoy 1996) on a grid that is as
    fine as the photos near and far: inverse depth along the rays of view 0. Marching cubes cut
    it. What lies beyond 1.3 times view 0's field of view is left out.
    """
    from scipy.ndimage import gaussian_filter
    from skimage.measure import marching_cubes

    shown, cameras = shown.to("cpu"), cameras.to("cpu")
    solid = shown.alphas[0, :, 0] > SOLID
    depths = torch.where(solid, shown.depths[0, :, 0], 0)
    if not solid.any():
        raise InputError("mesh: the scene shows no surface to any of its cameras.")
    frustum = _frustum(cameras, depths, detail)
    distance, weight = _distances(frustum, cameras, depths)
    distance, weight = (
        gaussian_filter(each.numpy(), SMOOTH) for each in (distance, weight)
    )
    known = weight > KNOWN
    field = distance / weight.clip(KNOWN)
    if not (field[known].min() < 0 < field[known].max()):
        raise InputError("mesh: the cameras see no surface from outside.")
    places, faces, _, _ = marching_cubes(field, 0.0, mask=known)
    vertices = _in_world(frustum, torch.from_numpy(places.copy()))
    colours = _colours(vertices, cameras, shown.images[0], depths, frustum.step)
    return Mesh(vertices.numpy(), faces, colours.numpy())


def _frustum(
    cameras: Cameras, depths: Float[Tensor, "view height width"], detail: float
) -> Frustum:
    """The grid that holds what `depths` (0: none) show."""
    inverse = 1 / depths[depths > 0].sort().values
    outer = int(OUTER * (len(inverse) - 1))
    near, far = float(inverse[outer]), float(inverse[-1 - outer])
    room = ROOM * max(near - far, 1e-3 * near)
    rows, columns, steps = (round(cells * detail) for cells in CELLS)
    sides = (torch.linspace(-0.5, 0.5, n) * WIDER + 0.5 for n in (rows, columns))
    y, x = torch.meshgrid(*sides, indexing="ij")
    pixels = torch.stack((x, y, torch.ones_like(x)), -1)
    c2w = cameras.c2w[0, 0]
    to_rays = c2w[:3, :3] @ torch.linalg.inv(cameras.intrinsics[0, 0])
    return Frustum(
        torch.einsum("ij,hwj->hwi", to_rays, pixels),
        c2w[:3, 3],
        torch.linspace(max(far - room, 0.5 * far), near + room, steps),
    )


def _distances(
    frustum: Frustum, cameras: Cameras, depths: Float[Tensor, "view height width"]
) -> tuple[Volume, Volume]:
    """Sums over the views of the distance before the surface [steps]; how many views know it."""
    shape = (*frustum.rays.shape[:2], len(frustum.inverse_depths))
    total, weight = torch.zeros(shape), torch.zeros(shape)
    for index, inverse in enumerate(frustum.inverse_depths):
        points = frustum.centre + frustum.rays / inverse
        for view, depth in enumerate(depths):
            camera = cameras.select([view])
            z, seen = _read(points, camera, depth[None])
            gap = 1 / z.clamp(min=1e-9) - 1 / seen[0].clamp(min=1e-9)
            distance = gap / frustum.step
            known = (z > 0) & (seen[0] > 0) & (distance > -REACH)
            total[:, :, index] += known * distance.clamp(max=REACH)
            weight[:, :, index] += known
    return total, weight


def _read(
    points: Float[Tensor, "row column 3"],
    camera: Cameras,
    maps: Float[Tensor, "channel height width"],
) -> tuple[Float[Tensor, "row column"], Float[Tensor, "channel row column"]]:
    """Camera z of points, and what maps of that camera show there (0 outside)."""
    grid, z = project(points.flatten(0, 1), camera.intrinsics[0, 0], camera.c2w[0, 0])
    shape = points.shape[:2]
    grid = grid.view(*shape, 2)
    return z.view(shape), warp(maps, grid, mode="nearest", padding="zeros")


def _in_world(
    frustum: Frustum, places: Float[Tensor, "vertex 3"]
) -> Float[Tensor, "vertex 3"]:
    """World points at places between the cells of the grid."""
    rows, columns = frustum.rays.shape[:2]
    corner = frustum.rays[0, 0]
    down = (frustum.rays[-1, 0] - corner) / (rows - 1)
    right = (frustum.rays[0, -1] - corner) / (columns - 1)
    row, column, step = places.to(corner).unbind(-1)
    rays = corner + row[:, None] * down + column[:, None] * right
    inverse = frustum.inverse_depths[0] + frustum.step * step
    return frustum.centre + rays / inverse[:, None]


def _colours(
    vertices: Float[Tensor, "vertex 3"],
    cameras: Cameras,
    images: Float[Tensor, "view 3 height width"],
    depths: Float[Tensor, "view height width"],
    step: float,
) -> Float[Tensor, "vertex 3"]:
    """The mean of what the views show of each vertex that lies on their surface; of one that none
    shows, that of the nearest.
    """
    total = torch.zeros(len(vertices), 4)
    for view, image in enumerate(images):
        maps = torch.cat((image, depths[view][None]))
        z, seen = _read(vertices[:, None], cameras.select([view]), maps)
        gap = 1 / z.clamp(min=1e-9) - 1 / seen[3].clamp(min=1e-9)
        near = gap.abs() < REACH * step
        weight = (near & (seen[3] > 0))[:, 0].float()
        total[:, :3] += weight[:, None] * seen[:3, :, 0].T
        total[:, 3] += weight
    colours = (total[:, :3] / total[:, 3:].clamp(min=1)).clamp(0, 1)
    shown = total[:, 3] > 0
    if shown.any() and not shown.all():
        _, nearest = cKDTree(vertices[shown].numpy()).query(vertices[~shown].numpy())
        colours[~shown] = colours[shown][nearest]
    return colours
