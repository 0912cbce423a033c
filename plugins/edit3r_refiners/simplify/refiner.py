"""The refiner `simplify`."""

from typing import Any

from pydantic import Field, field_validator

from edit3r.interfaces import Rasterizer, Refiner
from edit3r.types import Cameras, EditRequest, Gaussians, Views
from edit3r_refiners.simplify.budget import Budget, parse_budget, passes
from edit3r_refiners.simplify.settings import SimplifySettings
from edit3r_refiners.simplify.simplification import simplify


class SimplifyRefiner(Refiner):
    """Keeps only the Gaussians that the scene requires, or at most a number of them."""

    class Settings(SimplifySettings):
        gaussians: Budget = Field(
            "auto", description="all, auto (only what the scene requires), or the most there may be"
        )
        max_gaussians: int | None = Field(None, ge=1, description="never leave more than this")

        @field_validator("gaussians", mode="before")
        @classmethod
        def _parse_gaussians(cls, value: Any) -> Budget:
            return parse_budget(value)

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, views: Views, request: EditRequest, rasterizer: Rasterizer
    ) -> Gaussians:
        """Simplify once to the wished number and once more where `max_gaussians` asks for fewer."""
        for most in passes(self.settings.gaussians, self.settings.max_gaussians):
            gaussians = simplify(gaussians, cameras, rasterizer, most, self.settings).gaussians
        return gaussians
