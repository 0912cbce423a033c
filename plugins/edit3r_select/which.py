"""Pick among several things of one name: "the left cup", "the big one", "all cups"."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.instructions import EVERY
from edit3r.contract.interfaces import Proposal
from edit3r.kit.compute.colour import rgb_to_lab
from edit3r.kit.compute.colour_names import read_colour

# Sign of the axis along which the wanted one lies farthest: x to the right, y down.
_ALONG_X = {"left": -1, "leftmost": -1, "right": 1, "rightmost": 1}
_ALONG_Y = {"top": -1, "upper": -1, "bottom": 1, "lower": 1}
_FROM_MIDDLE = ("middle", "centre", "central")
_LARGE = (
    "big",
    "bigger",
    "biggest",
    "large",
    "larger",
    "largest",
    "front",
    "nearest",
    "closest",
)
_SMALL = ("small", "smaller", "smallest", "back", "farthest", "background")
_TALL = ("tall", "tallest")

Scores = Float[Tensor, "proposal"]


def pick(
    proposals: Sequence[Proposal],
    which: Sequence[str],
    image: Float[Tensor, "3 height width"],
) -> tuple[Proposal, ...]:
    """The proposals that the words mean; of one name, best first, without words the best alone.

    Words that tell nothing about place, size or colour are passed over.
    """
    if set(which) & EVERY:
        return tuple(proposals)
    rankings = [
        ranked
        for word in which
        if (ranked := _scores(word, proposals, image)) is not None
    ]
    if not rankings:
        return tuple(proposals[:1])
    total = torch.stack(rankings).sum(0)
    return (proposals[int(total.argmax())],)


def _scores(
    word: str, proposals: Sequence[Proposal], image: Float[Tensor, "3 height width"]
) -> Scores | None:
    """How well each proposal fits a word, in [0, 1]; None for a word that tells nothing."""
    height, width = image.shape[-2:]
    boxes = torch.tensor([proposal.box for proposal in proposals])
    x = (boxes[:, 0] + boxes[:, 2] / 2) / width
    y = (boxes[:, 1] + boxes[:, 3] / 2) / height
    if word in _ALONG_X:
        return _spread(_ALONG_X[word] * x)
    if word in _ALONG_Y:
        return _spread(_ALONG_Y[word] * y)
    if word in _FROM_MIDDLE:
        return _spread(-(x - x.median()).abs())
    if word in _LARGE:
        return _spread(torch.tensor([proposal.area for proposal in proposals]))
    if word in _SMALL:
        return _spread(-torch.tensor([proposal.area for proposal in proposals]))
    if word in _TALL:
        return _spread(boxes[:, 3])
    colour = read_colour(word.split())
    return (
        None
        if colour is None
        else _spread(-_distances(colour[0].rgb, proposals, image))
    )


def _spread(values: Scores) -> Scores:
    """Values stretched to [0, 1]."""
    low, high = values.min(), values.max()
    return (values - low) / (high - low).clamp(min=1e-9)


def _distances(
    rgb: tuple[float, float, float],
    proposals: Sequence[Proposal],
    image: Float[Tensor, "3 height width"],
) -> Scores:
    """Distance of each proposal's median colour to a colour, in chroma [CIE Lab]."""
    lab = rgb_to_lab(image)
    wanted = rgb_to_lab(image.new_tensor(rgb)[:, None, None])[:, 0, 0]
    medians = [lab[:, one.soft_mask > 0.5].median(dim=1).values for one in proposals]
    apart = torch.stack(medians) - wanted
    return (apart * apart.new_tensor([0.5, 1.0, 1.0])).norm(dim=1)
