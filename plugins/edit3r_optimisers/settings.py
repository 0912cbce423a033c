"""What all four methods share: how long and how fast to fit, where to begin."""

from pydantic import Field

from edit3r.config import PartChoice, Settings

__all__ = ["FitSettings", "MethodSettings"]


class FitSettings(Settings):
    """One fit. Step sizes are those of 3D Gaussian Splatting (Kerbl et al. 2023, section 7 and the
    authors' released code) unless the description says otherwise; `extent` is a typical distance to the scene."""

    ssim: float = Field(0.2, ge=0, le=1, description="weight of D-SSIM; the rest is the absolute difference")
    means_rate: float = Field(1.6e-4, ge=0, le=1, description="first step of the centres [extents]")
    means_rate_end: float = Field(1.6e-6, ge=0, le=1, description="last step of the centres [extents]")
    colour_rate: float = Field(
        0.02,
        ge=0,
        le=1,
        description="step of the colours; published 0.0025, for 30000 steps",
    )
    opacity_rate: float = Field(0.05, ge=0, le=1, description="step of the opacities' logits")
    scale_rate: float = Field(5e-3, ge=0, le=1, description="step of the scales' logarithms")
    rotation_rate: float = Field(1e-3, ge=0, le=1, description="step of the quaternions")


class MethodSettings(FitSettings):
    """A fit of the photos, edits, and a fit of the edits."""

    reconstructor: PartChoice = Field(
        PartChoice(name="classical", settings={"matcher": "posed"}), description="where the first Gaussians come from"
    )
    editor: PartChoice = Field(PartChoice(name="recolor"), description="edits; in a run, the run's own takes its place")
    rasterizer: PartChoice = Field(PartChoice(name="auto"), description="renders while fitting")
    prompt: str = Field("", description="what to change; in a run, the run's own takes its place")
    seed: int = Field(0, ge=0, lt=2**31, description="of the edits, in a run the run's own; and of the order of views")
    points: int = Field(10_000, ge=1, description="most Gaussians to begin with; a reconstruction is thinned to them")
    steps: int = Field(300, ge=1, le=1_000_000, description="steps of the fit to the photos")
    edit_steps: int = Field(300, ge=1, le=1_000_000, description="steps of the fit to the edits")
