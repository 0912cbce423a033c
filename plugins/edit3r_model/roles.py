"""Who is who among the views: view 0 is the reference, all others share one role, and each has its own weights."""

from dataclasses import dataclass

import torch
from jaxtyping import Int
from torch import Tensor

ROLES = 2
"""Number of weight sets: the reference's and the others'."""


@dataclass(frozen=True)
class Role:
    """The views that share one set of decoder and head weights, and what they read of the others."""

    own: slice  # views in this role
    sources: slice  # views that at least one of them reads
    reads: Int[Tensor, "reader read"]  # per own view: positions within `sources`, in view order


def assign_roles(views: int, device: torch.device | str = "cpu") -> tuple[Role, Role]:
    """Roles of `views` >= 2 views: every view reads all views but itself."""
    reference = Role(slice(0, 1), slice(1, views), torch.arange(views - 1, device=device)[None])
    last = views if views > 2 else 1  # with two views nobody reads view 1 from the others' side
    reads = [[other for other in range(views) if other != view] for view in range(1, views)]
    return reference, Role(slice(1, views), slice(0, last), torch.tensor(reads, device=device))
