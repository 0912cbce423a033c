"""Refiners: what changes a finished scene by looking at its photos."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.interfaces.rendering import Rasterizer
from edit3r.contract.types import Cameras, Gaussians, Views


@dataclass(frozen=True)
class RefineInputs:
    """All that a refiner may look at beside the Gaussians."""

    cameras: Cameras  # poses of all input views
    # images that show the edit; the first `views.count` cameras are theirs
    views: Views
    rasterizer: Rasterizer
    # in [0, 1], one for each camera; 1: may change; None: everything may
    masks: Float[Tensor, "batch camera height width"] | None = None
    before: Gaussians | None = None  # the scene before the edit, where it is known
    seed: int = 0

    @property
    def confined(self) -> bool:
        """Whether some pixels must stay as they were before the edit."""
        return self.masks is not None and not bool((self.masks > 0).all())


class Refiner(Configured, ABC):
    """One step after reconstruction: fewer or sharper Gaussians, or some kept as they were."""

    @abstractmethod
    def __call__(self, gaussians: Gaussians, inputs: RefineInputs) -> Gaussians:
        """Return the refined Gaussians, in the same frame."""


class ComparesWithBefore:
    """A refiner that needs `inputs.before`; without it the pipeline leaves the refiner out."""
