"""Nearest hit, texture and shading of every pixel, on the CPU with numba.

Four rays a pixel for the colour and the soft masks; the depth is that of the pixel's centre ray.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edit3r.compute.compiling import compiled
from edit3r_training.procedural_scenes import (
    CYLINDER,
    ELLIPSOID,
    LEVELS,
    ROOM,
    TILE,
    Scene,
)

_OFFSETS = np.array(
    [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25], [0.0, 0.0]]
)


@dataclass(frozen=True)
class CastImage:
    """What one camera sees."""

    image: NDArray[np.float32]  # [height, width, 3] sRGB in [0, 1]
    depth: NDArray[np.float32]  # [height, width] camera z > 0 [scene units]
    objects: NDArray[
        np.int32
    ]  # [4, height, width] object hit by each of the four colour rays

    def coverage(self, count: int) -> NDArray[np.float32]:
        """`[count, height, width]` share of each pixel that each object covers."""
        return np.stack(
            [
                (self.objects == index).mean(0, dtype=np.float32)
                for index in range(count)
            ]
        )


def cast(
    scene: Scene,
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
    surfaces = (scene.kinds, scene.centres, np.ascontiguousarray(scene.world_to_local))
    looks = (
        scene.textures,
        scene.repeats,
        scene.tints,
        scene.light,
        scene.ambient,
        bank,
    )
    camera = (np.ascontiguousarray(c2w, np.float64), np.linalg.inv(intrinsics))
    _cast(surfaces, looks, camera, image, depth, objects)
    return CastImage(image, depth, objects)


@compiled(nogil=True)
def _hit(kind, origin, ray):
    """(t, face) of the nearest hit with a unit primitive in its own frame; t = inf for a miss."""
    miss = (np.inf, 0)
    if kind == ELLIPSOID:
        a = ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2
        b = origin[0] * ray[0] + origin[1] * ray[1] + origin[2] * ray[2]
        c = origin[0] ** 2 + origin[1] ** 2 + origin[2] ** 2 - 1
        inside = b * b - a * c
        if inside <= 0:
            return miss
        t = (-b - np.sqrt(inside)) / a
        return (t, 0) if t > 1e-4 else miss
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
    if near > far:
        return miss
    if kind == ROOM:
        return (far, far_face) if far > 1e-4 else miss
    return (near, near_face) if near > 1e-4 else miss


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
    normal = np.zeros(3)
    if kind == ELLIPSOID:
        u = 0.5 + np.arctan2(point[0], point[2]) / (2 * np.pi)
        v = np.arccos(min(max(point[1], -1.0), 1.0)) / np.pi
        return 2 * u, v, point.copy()
    if kind == CYLINDER and face == 0:
        normal[0], normal[2] = point[0], point[2]
        return 1 + np.arctan2(point[0], point[2]) / np.pi, 0.5 + 0.5 * point[1], normal
    axis = 1 if kind == CYLINDER else face // 2
    normal[axis] = 1.0 if face % 2 else -1.0
    if kind == ROOM:
        normal[axis] = -normal[axis]
    return 0.5 + 0.5 * point[(axis + 1) % 3], 0.5 + 0.5 * point[(axis + 2) % 3], normal


@compiled(nogil=True)
def _texel(bank, texture, level, u, v, out):
    """Bilinear lookup with mirrored repeats, so that no seam shows."""
    side = TILE >> level
    u, v = abs((u + 1) % 2 - 1), abs((v + 1) % 2 - 1)
    x, y = u * (side - 1), v * (side - 1)
    x0, y0 = int(x), int(y)
    x1, y1 = min(x0 + 1, side - 1), min(y0 + 1, side - 1)
    fx, fy = x - x0, y - y0
    for c in range(3):
        top = (
            bank[texture, level, y0, x0, c] * (1 - fx)
            + bank[texture, level, y0, x1, c] * fx
        )
        bottom = (
            bank[texture, level, y1, x0, c] * (1 - fx)
            + bank[texture, level, y1, x1, c] * fx
        )
        out[c] = (top * (1 - fy) + bottom * fy) / 255


@compiled(nogil=True)
def _cast(surfaces, looks, camera, image, depth, objects):
    """Fill `image`, `depth` and `objects` pixel by pixel, by the nearest hit of five rays each."""
    kinds, centres, matrices = surfaces
    textures, repeats, tints, light, ambient, bank = looks
    c2w, inverse = camera
    height, width = depth.shape
    count = len(kinds)
    local_origins = np.empty((count, 3))
    extents = np.empty(count)
    for k in range(count):
        for i in range(3):
            local_origins[k, i] = 0.0
            for j in range(3):
                local_origins[k, i] += matrices[k, i, j] * (c2w[j, 3] - centres[k, j])
        extents[k] = 1 / np.sqrt((matrices[k] ** 2).sum() / 3)
    ray, local, best_local, point, colour = (
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
    )
    for y in range(height):
        for x in range(width):
            image[y, x] = 0
            for s in range(5):
                u, v = (
                    (x + 0.5 + _OFFSETS[s, 0]) / width,
                    (y + 0.5 + _OFFSETS[s, 1]) / height,
                )
                a = inverse[0, 0] * u + inverse[0, 1] * v + inverse[0, 2]
                b = inverse[1, 0] * u + inverse[1, 1] * v + inverse[1, 2]
                for i in range(3):
                    ray[i] = c2w[i, 0] * a + c2w[i, 1] * b + c2w[i, 2]
                best, best_object, best_face = np.inf, 0, 0
                for k in range(count):
                    for i in range(3):
                        local[i] = (
                            matrices[k, i, 0] * ray[0]
                            + matrices[k, i, 1] * ray[1]
                            + matrices[k, i, 2] * ray[2]
                        )
                    t, face = _hit(kinds[k], local_origins[k], local)
                    if t < best:
                        best, best_object, best_face = t, k, face
                        best_local[:] = local
                if s == 4:
                    depth[y, x] = best
                    continue
                k = best_object
                objects[s, y, x] = k
                for i in range(3):
                    point[i] = local_origins[k, i] + best * best_local[i]
                tu, tv, normal = _surface(kinds[k], best_face, point)
                # A pixel's width on the surface over a texel's: the mip level that does not
                # flicker.
                footprint = (
                    best * inverse[0, 0] / width / extents[k] * repeats[k] * TILE / 2
                )
                level = int(min(max(np.log2(max(footprint, 1.0)) + 0.5, 0), LEVELS - 1))
                _texel(
                    bank,
                    textures[k, best_face],
                    level,
                    tu * repeats[k],
                    tv * repeats[k],
                    colour,
                )
                facing, norm = 0.0, 0.0
                for i in range(3):  # normals go to the world by the transposed matrix
                    world = (
                        matrices[k, 0, i] * normal[0]
                        + matrices[k, 1, i] * normal[1]
                        + matrices[k, 2, i] * normal[2]
                    )
                    facing += world * light[i]
                    norm += world * world
                shade = ambient + (1 - ambient) * max(0.0, facing / np.sqrt(norm))
                for c in range(3):
                    image[y, x, c] += 0.25 * min(
                        1.0, colour[c] * tints[k, best_face, c] * shade
                    )
