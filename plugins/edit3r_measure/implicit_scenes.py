"""Dataset `implicit`: smooth bodies found by sphere tracing and coloured by formulas; for
measuring, not training.

It shares neither code nor textures with `procedural`, on which the small network was trained:
surfaces are signed distances (sphere tracing, Hart 1996) instead of intersected shapes, colours are
sums of waves in space instead of pictures, and the camera circles one group of things instead of
standing in a room. There is no anti-aliasing.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field

from edit3r import config
from edit3r.contract.interfaces import Dataset, SceneSample
from edit3r.contract.types import Cameras
from edit3r.geometry.cameras import intrinsics_from_fov, relative_to_first

STEPS, NEAR_ENOUGH, SKY = (
    72,
    1e-3,
    9.0,
)  # most steps of a ray; distance that counts as a hit; radius of the dome
DOME, FLOOR, BALL, RING, BOX, CAPSULE = range(-2, 4)
Points = Float[np.ndarray, "point 3"]


@dataclass(frozen=True)
class Body:
    """One thing, or the floor or the dome, with its pattern."""

    kind: int
    centre: np.ndarray  # [3], y down
    size: np.ndarray  # [3] half extents
    palette: np.ndarray  # [3, 3] sRGB
    waves: np.ndarray  # [2, 5, 4] direction times frequency, and phase

    def distance(self, points: Points) -> Float[np.ndarray, "point"]:
        """Return the signed distance, or a little less."""
        p = points - self.centre
        if self.kind == FLOOR:
            return self.centre[1] - points[:, 1]
        if self.kind == DOME:
            return SKY - np.linalg.norm(points, axis=1)
        if self.kind == BALL:
            return (np.linalg.norm(p / self.size, axis=1) - 1) * self.size.min()
        if self.kind == RING:
            return (
                np.hypot(np.hypot(p[:, 0], p[:, 1]) - self.size[0], p[:, 2])
                - 0.4 * self.size[1]
            )
        if self.kind == BOX:
            outside = np.abs(p) - 0.7 * self.size
            return (
                np.linalg.norm(outside.clip(0), axis=1)
                + outside.max(1).clip(max=0)
                - 0.3 * self.size.min()
            )
        p[:, 1] -= p[:, 1].clip(-0.6 * self.size[1], 0.6 * self.size[1])
        return np.linalg.norm(p, axis=1) - 0.6 * self.size[0]

    def shaded(self, points: Points) -> Points:
        """Return the colours of a matt surface under one lamp: sums of waves decide softly between
        three colours.
        """
        phases = (
            np.einsum("pi,swi->spw", points - self.centre, self.waves[..., :3])
            + self.waves[:, None, :, 3]
        )
        first, second = 0.5 + 0.5 * np.tanh(2.5 * np.sin(phases).sum(-1))[..., None]
        base = self.palette[0] * first + self.palette[1] * (1 - first)
        slope = np.stack(
            [
                self.distance(points + step) - self.distance(points - step)
                for step in 1e-3 * np.eye(3)
            ],
            1,
        )
        normals = slope / np.linalg.norm(slope, axis=1, keepdims=True).clip(1e-9)
        light = (
            1
            if self.kind == DOME
            else 0.45 + 0.55 * (normals @ [0.36, -0.8, -0.48]).clip(0)[:, None]
        )
        return (base * (1 - 0.6 * second) + 0.6 * second * self.palette[2]) * light


def draw_scene(rng: np.random.Generator) -> list[Body]:
    """Return dome, floor and five to eight bodies on the floor around the middle."""
    count = int(rng.integers(5, 9))
    sizes = rng.uniform(0.28, 0.6, (count, 3))
    turns = 2 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    radii = rng.uniform(0.5, 1.5, count)
    heights = 0.8 - sizes[:, 1] * rng.uniform(0.8, 2.0, count)
    centres = np.vstack(
        [
            np.zeros(3),
            [0, 0.8, 0],
            np.stack([radii * np.cos(turns), heights, radii * np.sin(turns)], 1),
        ]
    )
    bodies = []
    for kind, centre, size in zip(
        [DOME, FLOOR, *rng.integers(0, 4, count)], centres, [*np.ones((2, 3)), *sizes]
    ):
        frequency = (
            rng.uniform(0.8, 2.5) if kind == DOME else rng.uniform(5, 12)
        )  # [radians per unit]
        directions = rng.normal(size=(2, 5, 3)) * frequency / np.sqrt(3)
        waves = np.concatenate([directions, rng.uniform(0, 2 * np.pi, (2, 5, 1))], -1)
        bodies.append(
            Body(int(kind), centre, size, rng.uniform(0.05, 0.95, (3, 3)), waves)
        )
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
    directions, start = rays @ c2w[:3, :3].T / lengths[:, None], c2w[:3, 3]
    travelled, left = np.zeros(len(rays)), np.arange(len(rays))
    for _ in range(STEPS):
        gaps = np.min(
            [
                body.distance(start + travelled[left, None] * directions[left])
                for body in bodies
            ],
            0,
        )
        travelled[left] += gaps
        left = left[gaps > NEAR_ENOUGH]
    points = start + travelled[:, None] * directions
    owner, image = (
        np.argmin([body.distance(points) for body in bodies], 0),
        np.zeros_like(points),
    )
    for index in np.unique(owner):
        image[owner == index] = bodies[index].shaded(points[owner == index])
    return image.clip(0, 1).reshape(size, size, 3), (travelled / lengths).reshape(
        size, size
    )


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
        chosen, size = self.settings, (self.settings.image_size,) * 2
        rng = np.random.default_rng((chosen.seed, index))
        bodies = draw_scene(rng)
        poses = _circle(rng, chosen.context + chosen.targets, chosen.angles)
        k = intrinsics_from_fov(float(np.deg2rad(rng.uniform(40, 60))), size)
        versions = _edited(
            bodies,
            chosen.edit,
            np.random.default_rng((chosen.seed, index, 1 + chosen.edit_seed)),
        )
        views = [
            [render(own, pose, k.double().numpy(), size[0]) for pose in poses]
            for own in versions
        ]
        images = [
            torch.from_numpy(np.stack([image for image, _ in own]))
            .permute(0, 3, 1, 2)
            .float()
            for own in views
        ]
        depths = torch.from_numpy(np.stack([depth for _, depth in views[0]])).float()
        c2w = relative_to_first(torch.from_numpy(poses)[None]).float()
        cameras = Cameras(c2w, k.expand(1, len(poses), 3, 3), size)
        context, target = range(chosen.context), range(chosen.context, len(poses))
        known = {
            "context_depths": depths[context],
            "name": f"implicit-{chosen.seed}-{index}",
        }
        if len(images) == 2:
            known |= {
                "edited_context": images[1][context],
                "edited_target": images[1][target],
            }
        parts = (
            images[0][context],
            images[0][target],
            cameras.select(context),
            cameras.select(target),
        )
        return SceneSample(*parts, **known)


def _circle(
    rng: np.random.Generator, count: int, degrees: tuple[float, float]
) -> Float[np.ndarray, "view 4 4"]:
    """Return cameras (OpenCV axes) on a circle, `degrees` apart, that look at the middle from a
    little above.
    """
    turns = rng.uniform(0, 2 * np.pi) + np.deg2rad(
        np.cumsum(rng.uniform(*degrees, count))
    )
    height, away = rng.uniform(0.9, 2.0), rng.uniform(3.6, 4.8)
    centres = np.stack(
        [away * np.sin(turns), np.full(count, -height), away * np.cos(turns)], 1
    )
    poses, ahead = (
        np.tile(np.eye(4), (count, 1, 1)),
        -centres / np.linalg.norm(centres, axis=1, keepdims=True),
    )
    right = np.cross([0, 1, 0], ahead)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    poses[:, :3] = np.stack([right, np.cross(ahead, right), ahead, centres], 2)
    return poses


def _edited(
    bodies: list[Body], edit: str, rng: np.random.Generator
) -> list[list[Body]]:
    """Return the scene before and after, or alone without an edit; a body that is added is missing
    before.
    """
    chosen = int(rng.integers(2, len(bodies)))
    without, drawn = (
        bodies[:chosen] + bodies[chosen + 1 :],
        rng.uniform(0.05, 0.95, (3, 3)),
    )
    painted = [
        replace(b, palette=drawn) if n == chosen else b for n, b in enumerate(bodies)
    ]
    turned = [replace(b, palette=b.palette[:, [1, 2, 0]]) for b in bodies]
    pairs = {
        "add": [without, bodies],
        "remove": [bodies, without],
        "recolor": [bodies, painted],
    }
    return {**pairs, "global": [bodies, turned]}.get(edit, [bodies])
