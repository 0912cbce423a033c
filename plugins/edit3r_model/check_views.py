"""What a network must refuse at the door."""

from torch import Tensor

from edit3r.errors import InputError
from edit3r.types import Views


def check_views(views: Views, least: int) -> None:
    """Raise InputError that names the view whose picture or intrinsics cannot be used, or when there are too few."""
    if views.count < least:
        raise InputError(
            f"the network places views relative to each other and needs at least {least}, got {views.count}; add a "
            f"photo taken from another place."
        )
    for index in range(views.count):
        name = f"view {index}" + (f" ({views.names[index]})" if views.names else "")
        _require_finite(f"{name}: its picture", views.images[:, index])
        _require_finite(f"{name}: its intrinsics matrix", views.intrinsics[:, index])
        focal = views.intrinsics[:, index].diagonal(dim1=-2, dim2=-1)[:, :2]
        if (focal <= 0).any():
            raise InputError(f"{name}: focal lengths must be positive, got {focal[0].tolist()} (normalised).")


def _require_finite(what: str, tensor: Tensor) -> None:
    bad = int((~tensor.isfinite()).sum())
    if bad:
        raise InputError(f"{what} holds {bad} values that are not finite (NaN or infinite).")
