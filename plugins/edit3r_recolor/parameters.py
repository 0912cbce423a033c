"""Theta_r: the parameters of one region's colour transform, sampled once and reused in every view (section 3.2)."""

from dataclasses import asdict, dataclass

import torch
from pydantic import Field

from edit3r.config import Settings

JITTERS = ("brightness", "contrast", "saturation", "hue")

# Principal components of ImageNet's RGB values in [0, 1], one row each. The offset is the sum of direction times
# eigenvalue times a normal weight (Krizhevsky et al. 2012, section 4.1).
PCA_EIGENVALUES = (0.2175, 0.0188, 0.0045)
PCA_DIRECTIONS = ((-0.5675, -0.5808, -0.5836), (0.7192, -0.0045, -0.6948), (0.4009, -0.8140, 0.4203))


class RecolorRanges(Settings):
    """How strongly `sample_parameters` changes colours; factors are drawn from [1 - x, 1 + x] (gamma: [1/g, g])."""

    brightness: float = Field(0.3, ge=0, le=1, description="largest change of brightness [factor - 1]")
    contrast: float = Field(0.3, ge=0, le=1, description="largest change of contrast [factor - 1]")
    saturation: float = Field(0.5, ge=0, le=1, description="largest change of saturation [factor - 1]")
    hue: float = Field(0.5, ge=0, le=0.5, description="largest rotation of hue [turns]")
    gamma: float = Field(1.5, ge=1, le=4, description="largest gamma g; drawn from [1/g, g], evenly in its logarithm")
    lighting: float = Field(
        0.4,
        ge=0,
        le=2,
        description="standard deviation of the PCA lighting weights; 0.1 is barely visible",
    )
    permute_probability: float = Field(0.5, ge=0, le=1, description="how often RGB channels change places")
    greyscale_probability: float = Field(0.1, ge=0, le=1, description="how often all colour is taken away")


@dataclass(frozen=True)
class RecolorParameters:
    """One colour transform C_Theta; `to_json` and `from_json` keep it for a replay on any picture of any size."""

    brightness: float = 1.0  # factor on RGB
    contrast: float = 1.0  # factor on the distance from mid-grey
    saturation: float = 1.0  # factor on the distance from the pixel's own grey
    hue: float = 0.0  # rotation [turns]
    order: tuple[str, ...] = JITTERS  # of the four jitters above
    gamma: float = 1.0  # exponent
    lighting: tuple[float, float, float] = (0.0, 0.0, 0.0)  # PCA offset, as added to RGB
    permutation: tuple[int, int, int] = (0, 1, 2)  # output channel c is input channel permutation[c]
    greyscale: bool = False

    def __post_init__(self) -> None:
        if sorted(self.order) != sorted(JITTERS):
            raise ValueError(f"RecolorParameters.order: expected each of {JITTERS} once, got {self.order}")
        if sorted(self.permutation) != [0, 1, 2]:
            raise ValueError(f"RecolorParameters.permutation: expected an order of 0, 1, 2, got {self.permutation}")

    def to_json(self) -> dict:
        """Plain JSON data; floats survive exactly."""
        return asdict(self)

    @staticmethod
    def from_json(data: dict) -> "RecolorParameters":
        """Inverse of `to_json`, also after a trip through a JSON file, where tuples come back as lists."""
        return RecolorParameters(**{key: tuple(v) if isinstance(v, list) else v for key, v in data.items()})


def sample_parameters(generator: torch.Generator, ranges: RecolorRanges) -> RecolorParameters:
    """Theta_r for one region; the generator alone decides, whatever the pictures are."""

    def around(centre: float, width: float) -> float:
        return centre + width * (2 * torch.rand((), generator=generator, dtype=torch.float64).item() - 1)

    def chance(probability: float) -> bool:
        return torch.rand((), generator=generator).item() < probability

    order = torch.randperm(4, generator=generator).tolist()
    permutation = torch.randperm(3, generator=generator).tolist()
    return RecolorParameters(
        brightness=around(1, ranges.brightness),
        contrast=around(1, ranges.contrast),
        saturation=around(1, ranges.saturation),
        hue=around(0, ranges.hue),
        order=tuple(JITTERS[index] for index in order),
        gamma=ranges.gamma ** around(0, 1),
        lighting=_lighting_offset(generator, ranges.lighting),
        permutation=tuple(permutation) if chance(ranges.permute_probability) else (0, 1, 2),
        greyscale=chance(ranges.greyscale_probability),
    )


def _lighting_offset(generator: torch.Generator, deviation: float) -> tuple[float, float, float]:
    weights = deviation * torch.randn(3, generator=generator, dtype=torch.float64)
    scaled = weights * torch.tensor(PCA_EIGENVALUES, dtype=torch.float64)
    return tuple((scaled @ torch.tensor(PCA_DIRECTIONS, dtype=torch.float64)).tolist())
