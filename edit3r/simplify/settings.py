"""How much a simplification may change."""

from pydantic import Field

from edit3r.config import Settings


class SimplifySettings(Settings):
    """Tolerances; `scaled` turns all of them up or down together."""

    contribution: float = Field(
        0.02, ge=0, description="drop a Gaussian whose blending weight sums to less over the cameras [pixels]"
    )
    colour: float = Field(
        0.02, ge=0, le=1, description="standard deviation of colour within a merged cell, and between duplicates"
    )
    flatness: float = Field(
        0.5, ge=0, description="distance from the common plane within a merged cell [pixel footprints]"
    )
    duplicate_depth: float = Field(
        0.01, ge=0, le=1, description="relative difference of depth up to which two views show the same surface"
    )
    largest_cell: int = Field(5, ge=0, le=8, description="merged cells have sides of at most 2^this pixels")
    spread: float = Field(1.9, ge=1, le=4, description="size of a merged Gaussian against the moments of its cell")

    def scaled(self, factor: float) -> "SimplifySettings":
        """The same settings, `factor` times as tolerant."""
        changed = ("contribution", "colour", "flatness", "duplicate_depth")
        return self.model_copy(update={name: min(1.0, factor * getattr(self, name)) for name in changed})
