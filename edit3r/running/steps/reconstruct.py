"""Step 5: Gaussians and cameras of the edited views, and the scene before the edit."""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.component import component_name
from edit3r.contract.interfaces import (
    ComparesWithBefore,
    EditsViews,
    Geometry,
    Reconstructor,
)
from edit3r.contract.reporting import note, say, stage, warn
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit.cache import recall
from edit3r.kit.checks import check_reconstruction, errors_named_after
from edit3r.kit.geometry.gravity import quarter_turns
from edit3r.kit.geometry.light import estimate_light
from edit3r.kit.geometry.pose import estimate_cameras
from edit3r.running.editors import request_of
from edit3r.running.judging.between import guessed_between
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene, known_cameras

FINE_VIEWS = 20
"""Views whose grids are as fine as asked for: more have as many pixels together, since they show
the same surfaces again, and memory must hold them.
"""


@torch.no_grad()
def reconstruct(scene: Scene, parts: Parts) -> Scene:
    """Gaussians and cameras of the edited views, and the scene as it was before the edit."""
    with stage(f"reconstruct ({component_name(parts.reconstructor)})"):
        scene = _with_light(scene, parts)
        reconstruction = _reconstructed(scene, parts)
        scene = replace(scene, masks=_masks_of_change(scene, parts))
        scene = replace(scene, passing=_passing(scene, parts))
        scene = replace(scene, guessed=_guessed(scene, parts))
        before = _before(scene, parts)
    if before is not None:
        size = known_cameras(reconstruction).image_size
        cameras = known_cameras(before).at(size)
        reconstruction = replace(reconstruction, cameras=cameras)
    placed = _placed(reconstruction, scene.start.count)
    _tell_of_passing(scene)
    used = [view for view, there in enumerate(placed) if there]
    lost = [view for view, there in enumerate(placed) if not there]
    _tell_of_turned(scene.photos.select(used), known_cameras(reconstruction))
    left_out = scene.photos.select(lost) if lost else None
    scene = scene.select(used)
    reconstruction = _without_passing(reconstruction, scene)
    return replace(
        scene,
        before=before,
        reconstruction=reconstruction,
        gaussians=reconstruction.gaussians,
        placed=placed,
        left_out=left_out,
    )


def _tell_of_turned(photos: Views, cameras: Cameras) -> None:
    """Warn of photos that lie on their side beside the others: what was wide there was cut off."""
    turns = quarter_turns(cameras.c2w[0])
    for quarters, way in enumerate(("to the left", "by a half", "to the right"), 1):
        turned = photos.select((turns == quarters).nonzero()[:, 0].tolist())
        if turned.count:
            warn(
                f"{', '.join(turned.names) or 'A photo'}: not held as the other photos are, so a "
                f"part may be cut off and things are hard to name. Turn the file {way}, run again."
            )


def _passing(
    scene: Scene, parts: Parts
) -> Bool[Tensor, "batch view height width"] | None:
    """What passed while the photos were taken, but for what the user selected."""
    if not parts.uses_geometry or scene.photos.count < 3:
        return None
    if parts.config.passing == "keep":
        return None
    from edit3r.running.passing import passing

    found = passing(parts.geometry.of(scene.photos).required(), scene.photos)
    if found is not None and scene.confined:
        assert scene.masks is not None
        found &= scene.masks <= 0
    return found if found is not None and bool(found.any()) else None


def _guessed(scene: Scene, parts: Parts) -> Float[Tensor, "batch view"] | None:
    """How much of the picture half-way from each photo to its nearest one is guessed."""
    if not parts.uses_geometry:
        return None
    geometry = parts.geometry.of(scene.photos).required()
    return guessed_between(geometry, scene.photos)


def _without_passing(reconstruction: Reconstruction, scene: Scene) -> Reconstruction:
    """The reconstruction without what passed while the placed photos were taken."""
    if scene.passing is None:
        return reconstruction
    from edit3r.running.passing import without_passing

    cameras = known_cameras(reconstruction)
    gaussians = without_passing(
        reconstruction.gaussians, scene.passing, cameras.c2w, cameras.intrinsics
    )
    return replace(reconstruction, gaussians=gaussians)


def _tell_of_passing(scene: Scene) -> None:
    """Warn of what is left out since one photo alone shows it."""
    if scene.passing is None:
        return
    shares = scene.passing.float().mean((0, 2, 3)).tolist()
    note("passing", [round(share, 4) for share in shares])
    names = [
        f"{share:.1%} of {name}"
        for name, share in zip(scene.photos.called, shares)
        if share
    ]
    warn(
        f"{', '.join(names)}: shown by this photo alone where others see through its place, as a "
        "walker is; left out of the scene (--passing keep: not)."
    )


def _with_light(scene: Scene, parts: Parts) -> Scene:
    """The scene with the photos' light, where it stands on what they share."""
    if parts.config.light == "own" or not parts.uses_geometry:
        return scene
    geometry = parts.geometry.of(scene.photos).required()
    light = estimate_light(scene.photos, geometry)
    if light is not None:
        for name, value in (("gain", light.gain), ("offset", light.offset)):
            note(f"light.{name}", value[0, ..., 0, 0].tolist())
        say(
            "light",
            f"the photos differ by up to {255 * light.change:.0f} of 255; the scene has the light "
            "of the first (--light own: each its own)",
        )
    return replace(scene, light=light)


def _reconstructed(scene: Scene, parts: Parts) -> Reconstruction:
    """The edited views in 3D; their geometry is that of the photos, unless things come or go."""
    recon, edited = parts.reconstructor, scene.in_one_light(scene.edited)
    source = edited if parts.changes_shape else scene.in_one_light(scene.photos)
    geometry = _geometry(scene, parts, edited if parts.changes_shape else None)
    if not isinstance(recon, EditsViews):
        grid = _grid(parts, edited)
        return _checked(recon, edited, lambda: recon(edited, source, geometry, grid))
    task = parts.only_task
    request = request_of(task, scene, parts.config.seed, range(len(task.wishes)))
    return _checked(
        recon,
        edited,
        lambda: recon.edit_and_reconstruct(edited, source, request, geometry),
    )


def _geometry(
    scene: Scene, parts: Parts, reshaped: Views | None = None
) -> Geometry | None:
    """What the reconstructor is given of the photos' geometry; of the `reshaped` ones where the
    edit adds or removes things.
    """
    if not parts.reconstructor.uses_geometry:
        return None
    if reshaped is not None:
        return parts.geometry.of(reshaped).required()
    levelled = None if scene.light is None else scene.in_one_light(scene.photos)
    return parts.geometry.of(scene.photos, levelled).required()


def _grid(parts: Parts, views: Views) -> tuple[int, int]:
    """(height, width) of the grid of Gaussians: coarser than the views where refining follows."""
    refined = parts.config.refine and not parts.reconstructor.fuses_by_itself
    fine = min(1.0, (FINE_VIEWS / views.count) ** 0.5)
    share = parts.config.grid * fine if refined else 1.0
    height, width = views.image_size
    return max(1, round(share * height)), max(1, round(share * width))


def _checked(
    recon: Reconstructor, views: Views, compute: Callable[[], Reconstruction]
) -> Reconstruction:
    """The answer, held to the contract, with cameras by PnP where it predicts none, and without
    what could not be placed.
    """
    with errors_named_after(recon, views.images):
        reconstruction = compute()
    check_reconstruction(recon, views, reconstruction)
    if reconstruction.cameras is None:
        note("cameras", "PnP on the predicted Gaussian centres")
        per_pixel = reconstruction.per_pixel
        cameras = estimate_cameras(reconstruction.gaussians, views, per_pixel)
        reconstruction = replace(reconstruction, cameras=cameras)
    return _only_placed(reconstruction)


def _placed(reconstruction: Reconstruction, views: int) -> tuple[bool, ...]:
    """For each view whether it was placed in every scene of the batch."""
    if reconstruction.placed is None:
        return (True,) * views
    return tuple(reconstruction.placed.all(0).tolist())


def _only_placed(reconstruction: Reconstruction) -> Reconstruction:
    """The reconstruction without the Gaussians and cameras of views that could not be placed."""
    if reconstruction.placed is None or bool(reconstruction.placed.all()):
        return reconstruction
    count = reconstruction.placed.shape[1]
    placed = _placed(reconstruction, count)
    used = [view for view, there in enumerate(placed) if there]
    gaussians, cameras = reconstruction.gaussians, known_cameras(reconstruction)
    measured, fusion = reconstruction.measured, reconstruction.fusion
    # The new index of each view; the last entry is for Gaussians of no view, whose index is -1.
    new_index = torch.full((count + 1,), -1, device=gaussians.means.device)
    new_index[used] = torch.arange(len(used), device=new_index.device)
    kept = gaussians.select(
        (new_index[gaussians.view_index] >= 0) | (gaussians.view_index < 0)
    )
    return replace(
        reconstruction,
        gaussians=replace(kept, view_index=new_index[kept.view_index]),
        cameras=cameras.select(used),
        measured=measured[:, used] if measured is not None else None,
        fusion=fusion[:, used] if fusion is not None else None,
    )


def _masks_of_change(
    scene: Scene, parts: Parts
) -> Float[Tensor, "batch view height width"] | None:
    """Where the scene may change: the masks, else, after an earlier run, where the images did.

    Views that were not edited hold nothing back.
    """
    if scene.masks is not None or scene.before is None:
        return scene.masks
    changed = (scene.edited.images != scene.start.images).any(2).to(scene.start.images)
    if parts.config.edit_views == "first":
        changed[:, 1:] = 1
    return changed


def _before(scene: Scene, parts: Parts) -> Reconstruction | None:
    """The scene as it was before the edit, where a refiner needs it and some of it must stay."""
    needed = any(isinstance(refiner, ComparesWithBefore) for refiner in parts.refiners)
    if not needed or parts.changes_shape or not scene.confined:
        return None
    if scene.before is not None:  # an earlier run's
        return scene.before
    recon, photos = parts.reconstructor, scene.in_one_light(scene.photos)
    if isinstance(
        recon, EditsViews
    ):  # it has no answer for photos that are not to be edited
        return None
    geometry, grid = _geometry(scene, parts), _grid(parts, photos)

    def compute() -> Reconstruction:
        return _checked(recon, photos, lambda: recon(photos, photos, geometry, grid))

    return recall("before", recon, (photos, geometry, grid), compute)
