"""Dataset `implicit`: smooth bodies found by sphere tracing and coloured by formulas; for
measuring, not training. A local plugin:

    edit3r bench build --procedural 10 --set generator.dataset=implicit \\
        --plugin benchmarks/implicit_scenes.py --out implicit.json

`bench run` takes the same `--plugin`.

It shares neither code nor textures with `procedural`, on which the small network was trained:
surfaces are signed distances (sphere tracing, Hart 1996) instead of intersected shapes, colours are
sums of waves in space instead of images, and the camera circles one group of things instead of
standing in a room. There is no anti-aliasing.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field

from edit3r import Component, hookimpl
from edit3r.contract import settings as config
from edit3r.contract.interfaces import Dataset, SceneSample
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import intrinsics_from_fov, relative_to_first

EDIT3R_API = 1
MAX_STEPS = 72  # of a ray
NEAR_ENOUGH = 1e-3  # distance that counts as a hit
SKY = 9.0  # radius of the dome
DOME, FLOOR, BALL, RING, BOX, CAPSULE = range(-2, 4)
LIGHT = (0.36, -0.8, -0.48)

Points = Float[np.ndarray, "point 3"]
Distances = Float[np.ndarray, "point"]
Poses = Float[np.ndarray, "view 4 4"]


@hookimpl
def register_datasets() -> Component:
    return Component(
        "implicit",
        "implicit_scenes:ImplicitDataset",
        "smooth bodies coloured by formulas, with exact poses, depth and edited truth; to "
        "measure on",
    )


@dataclass(frozen=True)
class Body:
    """One thing, or the floor or the dome, with its pattern."""

    kind: int
    centre: np.ndarray  # [3], y down
    size: np.ndarray  # [3] half extents
    palette: np.ndarray  # [3, 3] sRGB
    waves: np.ndarray  # [2, 5, 4] direction times frequency, and phase

    def distance(self, points: Points) -> Distances:
        """Return the signed distance, or a little less."""
        p = points - self.centre
        size = self.size
        if self.kind == FLOOR:
            return -p[:, 1]
        if self.kind == DOME:
            return SKY - np.linalg.norm(points, axis=1)
        if self.kind == BALL:
            return (np.linalg.norm(p / size, axis=1) - 1) * size.min()
        if self.kind == RING:
            from_circle = np.hypot(p[:, 0], p[:, 1]) - size[0]
            return np.hypot(from_circle, p[:, 2]) - 0.4 * size[1]
        if self.kind == BOX:
            outside = np.abs(p) - 0.7 * size
            distance = np.linalg.norm(outside.clip(0), axis=1)
            return distance + outside.max(1).clip(max=0) - 0.3 * size.min()
        p[:, 1] -= p[:, 1].clip(-0.6 * size[1], 0.6 * size[1])
        return np.linalg.norm(p, axis=1) - 0.6 * size[0]

    def shaded(self, points: Points) -> Points:
        """Return the colours of a matt surface under one lamp: sums of waves decide softly between
        three colours.
        """
        from_centre = points - self.centre
        phases = np.einsum("pi,swi->spw", from_centre, self.waves[..., :3])
        sums = np.sin(phases + self.waves[:, None, :, 3]).sum(-1)
        first, second = 0.5 + 0.5 * np.tanh(2.5 * sums)[..., None]
        base = self.palette[0] * first + self.palette[1] * (1 - first)
        colour = base * (1 - 0.6 * second) + 0.6 * second * self.palette[2]
        if self.kind == DOME:
            return colour
        steps = 1e-3 * np.eye(3)
        slopes = [self.distance(points + s) - self.distance(points - s) for s in steps]
        slope = np.stack(slopes, 1)
        normals = slope / np.linalg.norm(slope, axis=1, keepdims=True).clip(1e-9)
        return colour * (0.45 + 0.55 * (normals @ LIGHT).clip(0)[:, None])


def draw_scene(rng: np.random.Generator) -> list[Body]:
    """Return dome, floor and five to eight bodies on the floor around the middle."""
    count = int(rng.integers(5, 9))
    sizes = rng.uniform(0.28, 0.6, (count, 3))
    turns = 2 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    radii = rng.uniform(0.5, 1.5, count)
    heights = 0.8 - sizes[:, 1] * rng.uniform(0.8, 2.0, count)
    around = np.stack([radii * np.cos(turns), heights, radii * np.sin(turns)], 1)
    kinds = [DOME, FLOOR, *rng.integers(0, 4, count).tolist()]
    centres = np.vstack([np.zeros(3), [0, 0.8, 0], around])
    bodies = []
    for kind, centre, size in zip(kinds, centres, np.vstack([np.ones((2, 3)), sizes])):
        slowest, fastest = (0.8, 2.5) if kind == DOME else (5, 12)  # [radians per unit]
        frequency = rng.uniform(slowest, fastest)
        directions = rng.normal(size=(2, 5, 3)) * frequency / np.sqrt(3)
        waves = np.concatenate([directions, rng.uniform(0, 2 * np.pi, (2, 5, 1))], -1)
        palette = rng.uniform(0.05, 0.95, (3, 3))
        bodies.append(Body(kind, centre, size, palette, waves))
    return bodies


def render(
    bodies: list[Body],
    c2w: Float[np.ndarray, "4 4"],
    k: Float[np.ndarray, "3 3"],
    size: int,
) -> tuple[Float[np.ndarray, "height width 3"], Float[np.ndarray, "height width"]]:
    """Return the image in [0, 1] and the camera z of a square view; `k` normalised."""
    y, x = (np.mgrid[:size, :size] + 0.5) / size
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(k).T
    lengths = np.linalg.norm(rays, axis=1)
    directions = rays @ c2w[:3, :3].T / lengths[:, None]
    start = c2w[:3, 3]
    travelled = np.zeros(len(rays))
    left = np.arange(len(rays))
    for _ in range(MAX_STEPS):
        points = start + travelled[left, None] * directions[left]
        gaps = np.min([body.distance(points) for body in bodies], 0)
        travelled[left] += gaps
        left = left[gaps > NEAR_ENOUGH]
    points = start + travelled[:, None] * directions
    owner = np.argmin([body.distance(points) for body in bodies], 0)
    image = np.zeros_like(points)
    for index in np.unique(owner):
        own = owner == index
        image[own] = bodies[index].shaded(points[own])
    depth = travelled / lengths
    return image.clip(0, 1).reshape(size, size, 3), depth.reshape(size, size)


class ImplicitDataset(Dataset):
    """Smooth bodies on a patterned floor; exact poses, depth and edited truth, each a function of
    seed and index.
    """

    class Settings(config.Settings):
        seed: int = Field(0, ge=0, description="two seeds share no scene")
        image_size: int = Field(
            128, ge=16, le=1024, description="height and width of the images [pixels]"
        )
        context: int = Field(2, ge=1, le=16, description="input views")
        targets: int = Field(
            1, ge=0, le=16, description="novel views, further along the circle"
        )
        angles: tuple[float, float] = Field(
            (3.0, 8.0), description="between neighbouring views [degrees]"
        )
        edit: Literal["none", "recolor", "add", "remove", "global"] = Field(
            "none", description="the edited truth"
        )
        edit_seed: int = Field(
            0, ge=0, description="other numbers edit the same scenes in other ways"
        )

    def __len__(self) -> int:
        return 10_000

    def __getitem__(self, index: int) -> SceneSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        chosen = self.settings
        size = chosen.image_size
        rng = np.random.default_rng((chosen.seed, index))
        bodies = draw_scene(rng)
        poses = _circle(rng, chosen.context + chosen.targets, chosen.angles)
        k = intrinsics_from_fov(np.deg2rad(rng.uniform(40, 60)), (size, size))
        edit_rng = np.random.default_rng((chosen.seed, index, 1 + chosen.edit_seed))
        before, after = _edited(bodies, chosen.edit, edit_rng)
        images, depths = _views(before, poses, k, size)
        c2w = relative_to_first(torch.from_numpy(poses)[None]).float()
        cameras = Cameras(c2w, k.expand(1, len(poses), 3, 3), (size, size))
        context = range(chosen.context)
        target = range(chosen.context, len(poses))
        sample = SceneSample(
            context=images[context],
            target=images[target],
            context_cameras=cameras.select(context),
            target_cameras=cameras.select(target),
            context_depths=depths[context],
            name=f"implicit-{chosen.seed}-{index}",
        )
        if after is None:
            return sample
        edited, _ = _views(after, poses, k, size)
        return replace(
            sample, edited_context=edited[context], edited_target=edited[target]
        )


def _views(
    bodies: list[Body], poses: Poses, k: torch.Tensor, size: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return images, channels first, and depths of all views."""
    views = [render(bodies, pose, k.double().numpy(), size) for pose in poses]
    images, depths = (torch.from_numpy(np.stack(own)).float() for own in zip(*views))
    return images.permute(0, 3, 1, 2).contiguous(), depths


def _circle(
    rng: np.random.Generator, count: int, degrees: tuple[float, float]
) -> Poses:
    """Return cameras (OpenCV axes) on a circle, `degrees` apart, that look at the middle from a
    little above.
    """
    start = rng.uniform(0, 2 * np.pi)
    turns = start + np.deg2rad(np.cumsum(rng.uniform(*degrees, count)))
    height = rng.uniform(0.9, 2.0)
    away = rng.uniform(3.6, 4.8)
    across = away * np.sin(turns)
    along = away * np.cos(turns)
    centres = np.stack([across, np.full(count, -height), along], 1)
    ahead = -centres / np.linalg.norm(centres, axis=1, keepdims=True)
    right = np.cross([0, 1, 0], ahead)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3] = np.stack([right, np.cross(ahead, right), ahead, centres], 2)
    return poses


def _edited(
    bodies: list[Body], edit: str, rng: np.random.Generator
) -> tuple[list[Body], list[Body] | None]:
    """Return the scene before and after, None without an edit; a body that is added is missing
    before.
    """
    chosen = int(rng.integers(2, len(bodies)))
    palette = rng.uniform(0.05, 0.95, (3, 3))
    others = bodies[:chosen] + bodies[chosen + 1 :]
    painted = list(bodies)
    painted[chosen] = replace(bodies[chosen], palette=palette)
    turned = [replace(body, palette=body.palette[:, [1, 2, 0]]) for body in bodies]
    edits = {
        "none": (bodies, None),
        "add": (others, bodies),
        "remove": (bodies, others),
        "recolor": (bodies, painted),
        "global": (bodies, turned),
    }
    return edits[edit]
