"""The settings that every rasterizer shares, and with them the rendering convention."""

from pydantic import Field, model_validator

from edit3r.config import Settings

BORDER = 0.3
"""Tangents in the projection's Jacobian are clamped this far beyond the picture's border [half picture widths]."""
MAX_COLOUR = 1e30
"""Colours are clamped to [0, MAX_COLOUR], so that no finite input makes an infinite picture."""
MIN_TOTAL_ALPHA = 1e-10
"""Expected depth divides by at least this alpha."""


class RasterizerSettings(Settings):
    """How Gaussians become pixels; the defaults are those of 3D Gaussian Splatting with a `max_alpha` of 0.999."""

    near: float = Field(0.01, ge=1e-6, le=1e10, description="Gaussians with camera z below are culled [scene units].")
    far: float = Field(1e10, ge=1e-6, le=1e15, description="Gaussians with camera z above are culled [scene units].")
    background: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="sRGB colour behind everything, each in [0, 1]."
    )
    eps2d: float = Field(0.3, ge=1e-3, le=100, description="Added to the variances in the picture [pixels^2].")
    max_alpha: float = Field(0.999, ge=0.01, le=0.9999, description="No Gaussian hides more of a pixel than this.")
    min_alpha: float = Field(1 / 255, ge=1e-5, le=0.5, description="A Gaussian is skipped where its alpha is below.")
    min_transmittance: float = Field(
        1e-4, ge=1e-6, le=0.5, description="A pixel ends before the Gaussian that takes its transmittance to or below."
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> "RasterizerSettings":
        if self.far <= self.near:
            raise ValueError(f"far ({self.far}) must be above near ({self.near})")
        if not all(0 <= channel <= 1 for channel in self.background):
            raise ValueError(f"background must be three numbers in [0, 1], got {self.background}")
        return self
