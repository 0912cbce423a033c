"""What the core holds every component to while it runs, so that a fault is named where it was made.

Called by the pipeline after each stage. A component that raises, or returns another size, dtype or
range than its interface promises, ends the run with one sentence that names it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from edit3r.contract.component import component_name
from edit3r.contract.errors import (
    Edit3rError,
    InputError,
    MatchingError,
    PluginError,
    is_out_of_memory,
)
from edit3r.contract.interfaces import (
    INTERFACES,
    Editor,
    MatchedGeometry,
    Matcher,
    Rasterizer,
    Reader,
    Reconstructor,
    Refiner,
    SceneToWrite,
    Writer,
)
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering, Views
from edit3r.contract.wishes import Wish


@contextmanager
def errors_named_after(component: Any) -> Iterator[None]:
    """Name the component in any error of its code that was not meant for the user."""
    try:
        yield
    except Edit3rError:
        raise
    except SystemExit as error:
        raise PluginError(
            f"{_who(component)} ended the program (sys.exit({error.code!r}))."
        ) from error
    except Exception as error:
        if is_out_of_memory(error):
            raise
        raise PluginError(
            f"{_who(component)} raised {type(error).__name__}: {error}."
        ) from error


def check_edit(editor: Editor, views: Views, answer: Views) -> None:
    """Number, size, dtype and range of the edited views."""
    _require_type(editor, answer, Views)
    given, images = views.images, answer.images
    sizes = f"gave it {list(given.shape)}, got back {list(images.shape)}"
    _require(
        editor,
        images.shape == given.shape,
        f"keep number and size of the views: {sizes}",
    )
    _require(
        editor,
        images.dtype == given.dtype,
        f"return {given.dtype} images, got {images.dtype}",
    )
    _require_finite(editor, "images", images)
    _require_range(editor, "images", images)


def check_needs(writer: Writer, scene: SceneToWrite) -> None:
    """What the writer needs of a scene must be known."""
    lacking = [name for name in writer.needs if getattr(scene, name) in (None, "", ())]
    if lacking:
        raise InputError(
            f"{component_name(writer)} needs {' and '.join(lacking)}, which this scene has not; "
            "write it of the folder of a run."
        )


def check_wishes(reader: Reader, wishes: tuple[Wish, ...]) -> None:
    """At least one, each of which says what shall happen to what."""
    _require_type(reader, wishes, tuple)
    _require(reader, len(wishes) > 0, "return a wish, or raise PromptError")
    for wish in wishes:
        _require_type(reader, wish, Wish)
        fault = wish.fault()
        _require(
            reader,
            not fault,
            f"return wishes that hold together; one {fault}: {wish!r}",
        )


def check_written(writer: Writer, path: Path) -> None:
    """One file, or one folder with something in it, as its suffix says."""
    if writer.offer.component.makes_folder:
        is_there = path.is_dir() and any(path.iterdir())
        promise = "make the folder that it is given, since its suffix has no dot"
    else:
        is_there = path.is_file()
        promise = "write the file that it is given, since its suffix has a dot"
    _require(writer, is_there, f"{promise}: {path.name}")


def check_geometry(matcher: Matcher, views: Views, answer: MatchedGeometry) -> None:
    """Shapes, dtype and finiteness of what a matcher found, and depths above 0."""
    _require_type(matcher, answer, MatchedGeometry)
    views_of = list(views.images.shape[:2])
    height, width = answer.depths.shape[-2:]
    shapes = {
        "c2w": [*views_of, 4, 4],
        "depths": [*views_of, height, width],
        "confidence": [*views_of, height, width],
        "registered": views_of,
    }
    for name, expected in shapes.items():
        tensor = getattr(answer, name)
        given = list(tensor.shape)
        promise = f"return {name} of shape {expected}, got {given}"
        _require(matcher, given == expected, promise)
        if name != "registered":
            promise = f"return {name} in {views.images.dtype}, got {tensor.dtype}"
            _require(matcher, tensor.dtype == views.images.dtype, promise)
            _require_finite(matcher, name, tensor)
    least = float(answer.depths.amin())
    _require(matcher, least > 0, f"return depths above 0, got {least:.4g}")


def check_reconstruction(
    recon: Reconstructor, views: Views, answer: Reconstruction
) -> None:
    """Batch, dtype, finiteness and ranges of the Gaussians, and the number of cameras."""
    _require_type(recon, answer, Reconstruction)
    _require_type(recon, answer.gaussians, Gaussians)
    check_gaussians(recon, answer.gaussians, views.images.shape[0], views.images.dtype)
    if answer.cameras is not None:
        expected, given = (
            list(views.images.shape[:2]),
            list(answer.cameras.c2w.shape[:2]),
        )
        _require(
            recon,
            given == expected,
            f"return one camera per view, {expected}, got {given}",
        )
    scenes, count = views.images.shape[:2]
    for name, expected in (
        ("placed", [scenes, count]),
        ("measured", [scenes, count]),
        ("fusion", [scenes, count, 3]),
    ):
        tensor = getattr(answer, name)
        given = expected if tensor is None else list(tensor.shape[: len(expected)])
        _require(
            recon,
            given == expected,
            f"return {name} for each of its views, {expected}, got {given}",
        )


def check_refinement(refiner: Refiner, given: Gaussians, answer: Gaussians) -> None:
    """Batch, dtype, finiteness and ranges of the refined Gaussians."""
    _require_type(refiner, answer, Gaussians)
    check_gaussians(refiner, answer, given.means.shape[0], given.means.dtype)


def check_gaussians(
    component: Any, gaussians: Gaussians, scenes: int, dtype: torch.dtype
) -> None:
    """Raise PluginError unless these are finite Gaussians of so many scenes, scales and opacities
    in range.
    """
    given = gaussians.means.shape[0]
    sizes = f"gave it {scenes} scenes, got back {given}"
    _require(
        component, given == scenes, f"return one set of Gaussians per scene: {sizes}"
    )
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        tensor = getattr(gaussians, name)
        _require(
            component,
            tensor.dtype == dtype,
            f"return {dtype} Gaussians, got {name} in {tensor.dtype}",
        )
        _require_finite(component, f"Gaussians with {name}", tensor)
    if gaussians.count:
        least = float(gaussians.scales.amin())
        _require(component, least > 0, f"return scales above 0, got {least:.4g}")
        _require_range(component, "opacities", gaussians.opacities)


def check_rendering(
    rasterizer: Rasterizer, gaussians: Gaussians, cameras: Cameras, answer: Rendering
) -> None:
    """Shapes, dtype and finiteness of a rendering."""
    _require_type(rasterizer, answer, Rendering)
    dtype = gaussians.means.dtype
    for name, channels in (("images", 3), ("alphas", 1), ("depths", 1)):
        tensor = getattr(answer, name)
        expected, given = (
            [*cameras.c2w.shape[:2], channels, *cameras.image_size],
            list(tensor.shape),
        )
        _require(
            rasterizer,
            given == expected,
            f"return {name} of shape {expected}, got {given}",
        )
        _require(
            rasterizer,
            tensor.dtype == dtype,
            f"return {name} in the Gaussians' {dtype}, got {tensor.dtype}",
        )
        _require_finite(rasterizer, name, tensor)


def _who(component: Any) -> str:
    """'editor 'sepia'', with the plugin's name where there is one of another name."""
    kind = next(
        (
            kind
            for kind, interface in INTERFACES.items()
            if isinstance(component, interface)
        ),
        "component",
    )
    offer = getattr(component, "offer", None)
    plugin = (
        f" of plugin {offer.plugin!r}"
        if offer is not None and offer.plugin != offer.component.name
        else ""
    )
    return f"{kind} {component_name(component)!r}{plugin}"


def _require(component: Any, held: bool, promise: str) -> None:
    """Raise PluginError, '... must `promise`.', unless it is held."""
    if not held:
        raise PluginError(f"{_who(component)} must {promise}.")


def _require_type(component: Any, answer: Any, expected: type) -> None:
    given = type(answer).__name__
    _require(
        component,
        isinstance(answer, expected),
        f"return edit3r.{expected.__name__}, got {given}",
    )


def _require_range(component: Any, what: str, tensor: torch.Tensor) -> None:
    low, high = float(tensor.amin()), float(tensor.amax())  # NaN is in no range
    _require(
        component,
        low >= 0 and high <= 1,
        f"return {what} in [0, 1], got {low:.4g} to {high:.4g}",
    )


def _require_finite(component: Any, what: str, tensor: torch.Tensor) -> None:
    if torch.isfinite(tensor.sum()):  # the quick way; a sum may also overflow
        return
    bad = int((~torch.isfinite(tensor)).sum())
    if bad:
        raise PluginError(
            f"{_who(component)} returned {what} with {bad} of {tensor.numel()} values not finite."
        )


def require_matchable(views: Views, least_size: int) -> None:
    """For matchers: raise MatchingError for fewer than two photos, or a side shorter than
    `least_size` [pixels].
    """
    if views.count < 2:
        raise MatchingError(
            f"matching needs at least two photos of the scene, got {views.count}."
        )
    if min(views.image_size) < least_size:
        height, width = views.image_size
        raise MatchingError(
            f"the photos have {width} x {height} pixels, too few to match; "
            f"give photos of at least {least_size} pixels a side."
        )
