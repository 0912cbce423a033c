"""Nearest hit, texture and shading of every pixel, on the CPU with numba.

Four rays a pixel for the colour and the soft masks; the depth is that of the pixel's centre ray.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edit3r.kit.compute.compiling import compiled
from edit3r_training.procedural_scenes import (
    CYLINDER,
    ELLIPSOID,
    LEVELS,
    ROOM,
    TILE,
    ProceduralScene,
)

_OFFSETS = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1], [0, 0]]) / 4
"""Of the rays from the pixel's centre [pixels]."""


@dataclass(frozen=True)
class CastImage:
    """What one camera sees."""

    image: NDArray[np.float32]  # [height, width, 3] sRGB in [0, 1]
    depth: NDArray[np.float32]  # [height, width] camera z > 0 [scene units]
    # [4, height, width] object hit by each of the four colour rays
    objects: NDArray[np.int32]

    def coverage(self, count: int) -> NDArray[np.float32]:
        """`[count, height, width]` share of each pixel that each object covers."""
        hits = self.objects == np.arange(count)[:, None, None, None]
        return hits.mean(1, dtype=np.float32)


def cast(
    scene: ProceduralScene,
    bank: NDArray[np.uint8],
    c2w: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    image_size: tuple[int, int],
) -> CastImage:
    """Ray-cast one image; `c2w` 4x4 with OpenCV axes, `intrinsics` normalised 3x3."""
    height, width = image_size
    image = np.empty((height, width, 3), np.float32)
    depth = np.empty((height, width), np.float32)
    objects = np.empty((4, height, width), np.int32)
    matrices = np.ascontiguousarray(scene.world_to_local)
    extents = 1 / np.sqrt((matrices**2).sum((1, 2)) / 3)
    surfaces = (scene.kinds, scene.centres, matrices, extents)
    looks = (scene.textures, scene.repeats, scene.tints, scene.light, scene.ambient)
    camera = (np.ascontiguousarray(c2w, np.float64), np.linalg.inv(intrinsics))
    _cast(surfaces, (*looks, bank), camera, image, depth, objects)
    return CastImage(image, depth, objects)


@compiled(nogil=True)
def _apply(matrix, vector):
    """The product of a matrix and a vector, as a tuple."""
    x, y, z = vector[0], vector[1], vector[2]
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@compiled(nogil=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled(nogil=True)
def _hit(kind, origin, ray):
    """(t, face) of the nearest hit with a unit primitive in its own frame; t = inf for a miss."""
    if kind == ELLIPSOID:
        return _hit_sphere(origin, ray)
    if kind == CYLINDER:
        return _hit_cylinder(origin, ray)
    near, far, near_face, far_face = -np.inf, np.inf, 0, 0
    for axis in range(3):
        step = ray[axis] if abs(ray[axis]) > 1e-12 else 1e-12
        first, second = (-1 - origin[axis]) / step, (1 - origin[axis]) / step
        low, high = 2 * axis, 2 * axis + 1
        if first > second:
            first, second, low, high = second, first, high, low
        if first > near:
            near, near_face = first, low
        if second < far:
            far, far_face = second, high
    t, face = (far, far_face) if kind == ROOM else (near, near_face)
    return (t, face) if near <= far and t > 1e-4 else (np.inf, 0)


@compiled(nogil=True)
def _hit_sphere(origin, ray):
    a, b, c = _dot(ray, ray), _dot(origin, ray), _dot(origin, origin) - 1
    inside = b * b - a * c
    t = (-b - np.sqrt(inside)) / a if inside > 0 else np.inf
    return (t if t > 1e-4 else np.inf), 0


@compiled(nogil=True)
def _hit_cylinder(origin, ray):
    """Cylinder around the y axis: mantle is face 0, caps are faces 2 and 3."""
    best, face = np.inf, 0
    a = ray[0] ** 2 + ray[2] ** 2
    if a > 1e-12:
        b = origin[0] * ray[0] + origin[2] * ray[2]
        inside = b * b - a * (origin[0] ** 2 + origin[2] ** 2 - 1)
        if inside > 0:
            t = (-b - np.sqrt(inside)) / a
            if t > 1e-4 and abs(origin[1] + t * ray[1]) <= 1:
                best = t
    if abs(ray[1]) > 1e-12:
        for side in range(2):
            t = (2 * side - 1 - origin[1]) / ray[1]
            x, z = origin[0] + t * ray[0], origin[2] + t * ray[2]
            if 1e-4 < t < best and x * x + z * z <= 1:
                best, face = t, 2 + side
    return best, face


@compiled(nogil=True)
def _surface(kind, face, point):
    """Texture coordinates in [0, 1] and the normal, both in the object's own frame."""
    x, y, z = point
    if kind == ELLIPSOID:
        u = 0.5 + np.arctan2(x, z) / (2 * np.pi)
        v = np.arccos(min(max(y, -1.0), 1.0)) / np.pi
        return 2 * u, v, point
    if kind == CYLINDER and face == 0:
        return 1 + np.arctan2(x, z) / np.pi, 0.5 + 0.5 * y, (x, 0.0, z)
    axis = 1 if kind == CYLINDER else face // 2
    sign = 1.0 if (face % 2 == 1) != (kind == ROOM) else -1.0
    normal = (sign * (axis == 0), sign * (axis == 1), sign * (axis == 2))
    return 0.5 + 0.5 * point[(axis + 1) % 3], 0.5 + 0.5 * point[(axis + 2) % 3], normal


@compiled(nogil=True)
def _texel(tile, level, u, v, out):
    """Bilinear lookup with mirrored repeats, so that no seam shows."""
    side = TILE >> level
    x, y = abs((u + 1) % 2 - 1) * (side - 1), abs((v + 1) % 2 - 1) * (side - 1)
    x0, y0 = int(x), int(y)
    x1, y1 = min(x0 + 1, side - 1), min(y0 + 1, side - 1)
    fx, fy = x - x0, y - y0
    for c in range(3):
        top = tile[level, y0, x0, c] * (1 - fx) + tile[level, y0, x1, c] * fx
        bottom = tile[level, y1, x0, c] * (1 - fx) + tile[level, y1, x1, c] * fx
        out[c] = (top * (1 - fy) + bottom * fy) / 255


@compiled(nogil=True)
def _trace(kinds, matrices, origins, ray):
    """(distance, object, face) of the nearest hit."""
    best, best_object, best_face = np.inf, 0, 0
    for k in range(len(kinds)):
        t, face = _hit(kinds[k], origins[k], _apply(matrices[k], ray))
        if t < best:
            best, best_object, best_face = t, k, face
    return best, best_object, best_face


@compiled(nogil=True)
def _cast(surfaces, looks, camera, image, depth, objects):
    """Fill `image`, `depth` and `objects` pixel by pixel, by the nearest hit of five rays each."""
    kinds, centres, matrices, extents = surfaces
    textures, repeats, tints, light, ambient, bank = looks
    c2w, inverse = camera
    height, width = depth.shape
    origins, colour = np.empty_like(centres), np.empty(3)
    for k in range(len(kinds)):
        origins[k, 0], origins[k, 1], origins[k, 2] = _apply(
            matrices[k], c2w[:3, 3] - centres[k]
        )
    for y in range(height):
        for x in range(width):
            image[y, x] = 0
            for s in range(5):
                u = (x + 0.5 + _OFFSETS[s, 0]) / width
                v = (y + 0.5 + _OFFSETS[s, 1]) / height
                ray = _apply(c2w, _apply(inverse, (u, v, 1.0)))
                t, k, face = _trace(kinds, matrices, origins, ray)
                if s == 4:
                    depth[y, x] = t
                    continue
                objects[s, y, x] = k
                local, origin = _apply(matrices[k], ray), origins[k]
                point = (
                    origin[0] + t * local[0],
                    origin[1] + t * local[1],
                    origin[2] + t * local[2],
                )
                tu, tv, normal = _surface(kinds[k], face, point)
                # A pixel's width on the surface over a texel's: the mip level that does not
                # flicker.
                wide = t * inverse[0, 0] / width / extents[k]
                footprint = wide * repeats[k] * TILE / 2
                level = int(min(max(np.log2(max(footprint, 1.0)) + 0.5, 0), LEVELS - 1))
                tile = bank[textures[k, face]]
                _texel(tile, level, tu * repeats[k], tv * repeats[k], colour)
                # Normals go to the world by the transposed matrix.
                world = _apply(matrices[k].T, normal)
                facing = _dot(world, light) / np.sqrt(_dot(world, world))
                shade = ambient + (1 - ambient) * max(0.0, facing)
                for c in range(3):
                    shaded = colour[c] * tints[k, face, c] * shade
                    image[y, x, c] += 0.25 * min(1.0, shaded)
