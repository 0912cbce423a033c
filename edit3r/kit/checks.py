"""Faults of components in words: what one must do, its kind, its name and its plugin."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from numbers import Real
from typing import Any

import torch

from edit3r.contract.component import component_name
from edit3r.contract.errors import (
    Edit3rError,
    InputError,
    MatchingError,
    PluginError,
    SettingsError,
    is_out_of_memory,
)
from edit3r.contract.interfaces import INTERFACES, Geometry, Rasterizer, Reconstructor
from edit3r.contract.types import PER_GAUSSIAN, Gaussians, Views


@contextmanager
def errors_named_after(component: Any, *given: torch.Tensor) -> Iterator[None]:
    """Name the component in any error of its code that was not meant for the user.

    It must leave what it is `given` as it was, since others work with the same tensors.
    """
    before = [tensor.clone() for tensor in given]
    try:
        yield
    except Edit3rError:
        raise
    except SystemExit as error:
        raise PluginError(
            f"{named_after(component)} ended the program (sys.exit({error.code!r}))."
        ) from error
    except Exception as error:
        if is_out_of_memory(error):
            raise
        told = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".:")
        raise PluginError(f"{named_after(component)} raised {told}.") from error
    unchanged = all(torch.equal(tensor, copy) for tensor, copy in zip(given, before))
    promise = "leave its arguments as they are, and changed one in place"
    require(component, unchanged, f"{promise}; clone it first")


def named_after(component: Any) -> str:
    """'editor 'sepia'', with the plugin's name where there is one of another name."""
    kinds = (kind for kind, its in INTERFACES.items() if isinstance(component, its))
    named = f"{next(kinds, 'component')} {component_name(component)!r}"
    offer = getattr(component, "offer", None)
    if offer is None or offer.plugin == offer.component.name:
        return named
    return f"{named} of plugin {offer.plugin!r}"


def where(cls: type) -> str:
    """A class as a plugin imports it: edit3r.contract.types.Views."""
    if cls.__module__ == "builtins":
        return cls.__name__
    # interfaces are a package that names them all
    contract = cls.__module__.split(".")[:3]
    return ".".join((*contract, cls.__name__))


def require(component: Any, held: bool, promise: str) -> None:
    """Raise PluginError, '... must `promise`.', unless it is held."""
    if not held:
        raise PluginError(f"{named_after(component)} must {promise}.")


def require_type(component: Any, answer: Any, expected: type) -> None:
    promise = f"return {where(expected)}, got {type(answer).__name__}"
    require(component, isinstance(answer, expected), promise)


def require_tensor(
    component: Any, name: str, answer: Any, shape: Sequence, dtype: torch.dtype
) -> None:
    """A tensor of that shape and dtype, without values that are not finite."""
    given = type(answer).__name__
    is_tensor = isinstance(answer, torch.Tensor)
    require(component, is_tensor, f"return {name} as a tensor, got {given}")
    promise = f"return {name} of shape {list(shape)}, got {list(answer.shape)}"
    require(component, list(answer.shape) == list(shape), promise)
    require_numbers(component, name, answer, dtype)


def require_shares(
    component: Any, name: str, answer: Any, shape: Sequence, dtype: torch.dtype
) -> None:
    """The same, all in [0, 1]."""
    require_tensor(component, name, answer, shape, dtype)
    require_range(component, name, answer)


def require_numbers(
    component: Any, name: str, tensor: torch.Tensor, dtype: torch.dtype
) -> None:
    """Of the promised type, and finite."""
    promise = f"return {name} in {dtype}, got {tensor.dtype}"
    require(component, tensor.dtype == dtype, promise)
    if torch.isfinite(tensor.sum()):  # the quick way; a sum may also overflow
        return
    bad = int((~torch.isfinite(tensor)).sum())
    if bad:
        raise PluginError(
            f"{named_after(component)} returned {name} with {bad} of {tensor.numel()} values not "
            "finite."
        )


def require_range(component: Any, name: str, tensor: torch.Tensor) -> None:
    low, high = float(tensor.amin()), float(tensor.amax())  # NaN is in no range
    promise = f"return {name} in [0, 1], got {low:.4g} to {high:.4g}"
    require(component, low >= 0 and high <= 1, promise)


def require_share(component: Any, name: str, value: Any) -> None:
    held = isinstance(value, Real) and 0 <= float(value) <= 1  # NaN is in no range
    require(component, held, f"return {name} in [0, 1], got {value!r}")


def require_gaussians(
    component: Any, gaussians: Gaussians, scenes: int, dtype: torch.dtype
) -> None:
    """Raise PluginError unless these are finite Gaussians of so many scenes, all in range."""
    given = gaussians.means.shape[0]
    sizes = f"gave it {scenes} scenes, got back {given}"
    promise = f"return one set of Gaussians per scene: {sizes}"
    require(component, given == scenes, promise)
    for name in PER_GAUSSIAN:
        require_numbers(component, name, getattr(gaussians, name), dtype)
    if gaussians.count:
        least = float(gaussians.scales.amin())
        require(component, least > 0, f"return scales above 0, got {least:.4g}")
        require_range(component, "opacities", gaussians.opacities)


def require_gives(
    rasterizer: Rasterizer | type[Rasterizer], name: str, *needed: str, who: str
) -> None:
    """Raise SettingsError where the rasterizer called `name` does not give all that `who` needs."""
    if any(one not in rasterizer.gives for one in needed):
        raise SettingsError(
            f"rasterizer {name!r} gives {' and '.join(rasterizer.gives) or 'nothing'}, and {who} "
            f"needs {', '.join(needed)}; choose another (edit3r list-plugins --kind rasterizer)."
        )


def require_matchable(views: Views, least_size: int) -> None:
    """For matchers: raise MatchingError for one photo, or sides below `least_size` [pixels]."""
    if views.count < 2:
        raise MatchingError(
            f"matching needs at least two photos of the scene, got {views.count}."
        )
    if min(views.image_size) < least_size:
        height, width = views.image_size
        raise MatchingError(
            f"the photos have {width} x {height} pixels, too small to match; "
            f"give photos of at least {least_size} pixels a side."
        )


def require_geometry(
    reconstructor: Reconstructor, geometry: Geometry | None
) -> Geometry:
    """For reconstructors that use geometry: raise InputError where the caller gives none."""
    if geometry is None:
        raise InputError(
            f"reconstructor {component_name(reconstructor)!r} needs geometry, and none was given; "
            'pass that of a matcher: edit3r.build("matcher", "auto").match(source).'
        )
    return geometry
