"""The colours that make chosen Gaussians look like edited pictures, solved for directly.

A picture is linear in the colours of the Gaussians, so those that fit all pictures best are the
solution of one linear system: by conjugate gradients (Hestenes and Stiefel 1952), whose products
are a rendering and its transpose. No gradient steps, no step sizes.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.reporting import track
from edit3r.contract.types import DC, Cameras, Gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc, dc_to_colour

# The numbers of this block: no figures kept.
STEPS = 6  # of the conjugate gradients: further ones fit the noise of single pixels
HELD = 0.02  # weight of the mean change beside the pictures [of what a Gaussian shows]
SEEN = (
    0.05  # share of a pixel, over all pictures, below which neighbours tell the change
)
NEIGHBOURS = 4
OFFSET = 4.0  # added to signed colours: a rasterizer draws none below 0

Colours = Float[Tensor, "gaussian 3"]
Pictures = Float[Tensor, "camera 3 height width"]


def solve_colours(
    gaussians: Gaussians,
    cameras: Cameras,
    change: Pictures,
    chosen: Bool[Tensor, "gaussian"],
    rasterizer: Rasterizer,
) -> Colours:
    """What is added to the colours of one scene (batch 1), so that its pictures change by `change`.

    0 for all that are not `chosen`. Those that hardly show in any picture change as their nearest
    chosen neighbours do.
    """
    grey = replace(gaussians, harmonics=torch.zeros_like(gaussians.harmonics[:, :, :1]))
    weights = rasterizer.contributions(grey, cameras)[0]
    shown = (weights > 0).nonzero()[:, 0]
    scene, mine = grey.select(shown), chosen[shown]
    total = weights[shown]
    system = _System(scene, cameras, mine, rasterizer)
    mean = system.transposed(change) / total.clamp(min=1e-6)[:, None]
    # The residual and what holds the solution to the mean, as one least-squares problem.
    damping = (HELD * total.clamp(min=1e-6))[:, None]
    solution = torch.zeros_like(mean)
    residual = system.transposed(change - system.rendered(mean))
    scale = 1 / total.clamp(min=SEEN)[:, None]
    step = scale * residual
    direction, size = step, (residual * step).sum(0)
    for _ in track(range(STEPS), "solve for colours"):
        product = system.transposed(system.rendered(direction)) + damping * direction
        length = size / (direction * product).sum(0).clamp(min=1e-20)
        solution = solution + length * direction
        residual = residual - length * product
        step = scale * residual
        new = (residual * step).sum(0)
        direction = step + new / size.clamp(min=1e-20) * direction
        size = new
    found = torch.zeros_like(gaussians.means[0])
    found[shown] = (mean + solution) * mine[:, None]
    return _with_neighbours(gaussians, chosen, weights, found)


class _System:
    """Pictures of colours, and colours of pictures: a matrix and its transpose."""

    def __init__(
        self,
        scene: Gaussians,
        cameras: Cameras,
        chosen: Bool[Tensor, "gaussian"],
        rasterizer: Rasterizer,
    ) -> None:
        self.scene, self.cameras, self.chosen = scene, cameras, chosen
        self.rasterizer = rasterizer
        self.blank = self._drawn(torch.zeros_like(scene.means[0]))

    def rendered(self, colours: Colours) -> Pictures:
        return self._drawn(colours * self.chosen[:, None]) - self.blank

    def transposed(self, pictures: Pictures) -> Colours:
        found = self.rasterizer.contributions(self.scene, self.cameras, pictures)
        return found[0] * self.chosen[:, None]

    def _drawn(self, colours: Colours) -> Pictures:
        harmonics = colour_to_dc(colours + OFFSET)[None, :, None]
        shown = replace(self.scene, harmonics=harmonics)
        pictures = [
            self.rasterizer.render(shown, self.cameras.select([camera])).images[0]
            for camera in range(self.cameras.count)
        ]
        return torch.cat(pictures)


def _with_neighbours(
    gaussians: Gaussians,
    chosen: Bool[Tensor, "gaussian"],
    weights: Float[Tensor, "gaussian"],
    found: Colours,
) -> Colours:
    """The changes; of a chosen Gaussian that nobody sees, those of its neighbours."""
    known = (chosen & (weights > SEEN)).nonzero()[:, 0]
    asked = (chosen & (weights <= SEEN)).nonzero()[:, 0]
    if not len(known) or not len(asked):
        return found
    points = gaussians.means[0]
    size = (points[known].amax(0) - points[known].amin(0)).max().clamp(min=1e-9)
    colours = dc_to_colour(gaussians.harmonics[0, :, 0]).clamp(0, 1)
    places = torch.cat((points / size, 0.1 * colours), 1)
    count = min(NEIGHBOURS, len(known))
    _, near = cKDTree(places[known].numpy()).query(
        places[asked].numpy(), count, workers=-1
    )
    near = torch.from_numpy(near.reshape(len(asked), -1))
    found = found.clone()
    found[asked] = found[known][near].mean(1)
    return found


def bounded(before: Colours, change: Colours) -> Colours:
    """The change, cut where it would leave [0, 1] farther than the colour was outside before."""
    low, high = before.clamp(max=0), before.clamp(min=1)
    return (before + change).clamp(min=low, max=high) - before


def shine_of(
    gaussians: Gaussians,
    cameras: Cameras,
    wanted: Pictures,
    inside: Bool[Tensor, "camera height width"],
    chosen: Bool[Tensor, "gaussian"],
    rasterizer: Rasterizer,
) -> Float[Tensor, "3 3"]:
    """The colours [new, old] that what changes with direction takes on chosen Gaussians.

    How a surface shines stays; of which colour its shine is, is fitted to the `wanted` pictures,
    once for the whole thing. The identity where the pictures do not tell.
    """
    identity = torch.eye(3)
    plain = replace(gaussians, harmonics=gaussians.harmonics.clone())
    plain.harmonics[0, chosen, 1:] = 0
    left, right = torch.zeros(3, 3), torch.zeros(3, 3)
    for camera in range(cameras.count):
        if not bool(inside[camera].any()):
            continue
        one = cameras.select([camera])
        whole, base = (
            rasterizer.render(each, one).images[0, 0][:, inside[camera]]
            for each in (gaussians, plain)
        )
        shine, missing = whole - base, wanted[camera][:, inside[camera]] - base
        left += missing @ shine.T
        right += shine @ shine.T
    held = 0.1 * right.diagonal().mean() + 1e-6
    return torch.linalg.solve(right + held * identity, (left + held * identity).T).T


def repainted(
    gaussians: Gaussians, chosen: Bool[Tensor, "gaussian"], change: Colours
) -> Gaussians:
    """One scene (batch 1) with other constant harmonics of the chosen Gaussians."""
    harmonics = gaussians.harmonics.clone()
    harmonics[0, chosen, 0] += change[chosen] / DC
    return replace(gaussians, harmonics=harmonics)
