"""Which proposals are kept as regions: the paper's five criteria (section 3.2).

The paper gives its thresholds in an appendix that is not public; these defaults are this project's own. They let
through what the `classical` segmenter thinks of plain objects, whose stability and quality are proxies; with `sam2`
raise them (0.92 and 0.85 are usual for it).
"""

from collections import Counter
from collections.abc import Sequence

from pydantic import Field, field_validator

from edit3r.config import Settings
from edit3r.interfaces import Proposal


class ProposalFilter(Settings):
    """Deterministic thresholds."""

    min_area: float = Field(0.01, ge=0, le=1, description="least share of the first picture")
    min_stability: float = Field(0.8, ge=0, le=1, description="least overlap of the mask under two thresholds")
    min_predicted_iou: float = Field(0.4, ge=0, le=1, description="least quality that the mask believes it has")
    aspect: tuple[float, float] = Field((0.2, 5.0), description="least and most width / height of the box")
    margin: int = Field(2, ge=0, description="least distance of the box to the border [pixels]")

    @field_validator("aspect")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not 0 < value[0] <= value[1]:
            raise ValueError("expected [least, most] with 0 < least <= most")
        return value

    def objection(self, proposal: Proposal, image_size: tuple[int, int]) -> str | None:
        """The first criterion that `proposal` fails on a picture of (height, width) pixels; None: it is kept."""
        x, y, width, height = proposal.box
        margin = min(x, y, image_size[1] - (x + width), image_size[0] - (y + height))
        aspect = width / height if height > 0 else 0.0
        checks = {
            "area": proposal.area >= self.min_area,
            "stability": proposal.stability >= self.min_stability,
            "predicted IoU": proposal.predicted_iou >= self.min_predicted_iou,
            "aspect": self.aspect[0] <= aspect <= self.aspect[1],
            "margin": margin >= self.margin,
        }
        return next((name for name, passed in checks.items() if not passed), None)


def kept_proposals(
    proposals: Sequence[Proposal], image_size: tuple[int, int], criteria: ProposalFilter
) -> tuple[list[Proposal], dict[str, int]]:
    """Those that pass, in their order, and how many failed each criterion (by the first one they fail)."""
    objections = [criteria.objection(proposal, image_size) for proposal in proposals]
    kept = [proposal for proposal, objection in zip(proposals, objections) if objection is None]
    return kept, dict(Counter(objection for objection in objections if objection is not None))
