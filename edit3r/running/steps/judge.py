"""Step 7: the scene seen from the photos' places, and the verdicts on scene and edit."""

from dataclasses import replace

import torch

from edit3r.contract.component import component_name
from edit3r.contract.interfaces import (
    Geometry,
    HalfWay,
    Rasterizer,
    Reference,
    SceneToJudge,
)
from edit3r.contract.reporting import stage
from edit3r.contract.types import (
    Cameras,
    Gaussians,
    Reconstruction,
    Rendering,
    Views,
)
from edit3r.contract.verdicts import EditVerdict
from edit3r.kit import asking
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.kit.geometry.paths import half_way
from edit3r.kit.photos.images import evenly
from edit3r.kit.rendering import render_each
from edit3r.running.components import Components
from edit3r.running.editors import edit_to_judge
from edit3r.running.records import (
    EditedPhotos,
    ExposureCorrected,
    Inputs,
    Judged,
    Located,
    Reconstructed,
    SelectedRegions,
)
from edit3r.running.scene_input import SceneInput

HALF_WAY_SIZE = 256  # longer side [pixels]: critics look at no finer pictures
# places from which a reference is looked at: all Gaussians of all photos are drawn from each, so
# from fewer where there are many photos
FEWEST_PLACES, MOST_PLACES, MOST_DRAWN = 2, 8, 64
# standard deviation of the reference's Gaussians [pixels]: no gaps, no blur; by eye
FOOTPRINT = 0.6


@torch.no_grad()
def judge(
    inputs: Inputs,
    located: Located,
    selection: SelectedRegions,
    edit: EditedPhotos,
    corrected: ExposureCorrected,
    reconstructed: Reconstructed,
    gaussians: Gaussians,
    components: Components,
) -> Judged:
    """The refined scene from its input views, and the verdicts."""
    size = inputs.start.image_size
    with stage("check"):
        first, rendered = _from_photos(
            corrected, reconstructed, gaussians, size, components.rasterizer
        )
        cameras, half = reconstructed.cameras.at(size), None
        # Half-way between places around a scene is a place like any other.
        if cameras.count > 1 and inputs.scene is None:
            half = seen_half_way(
                components.rasterizer, gaussians, cameras, corrected.edited
            )
        reference, first_half = None, None
        if located.geometry is not None and inputs.scene is None:
            used, drawn_by = reconstructed.used, components.rasterizer
            most = places_asked(cameras.count)
            reference = _reference(
                located.geometry, used, corrected.edited, drawn_by, most
            )
            before = reconstructed.reconstruction.gaussians
            if half is not None and (gaussians is not before or len(half.pairs) > most):
                first_half = seen_half_way(
                    drawn_by, before, cameras, corrected.edited, most
                )
        verdict = asking.judge_scene(
            components.critic,
            SceneToJudge(
                photos=reconstructed.photos,
                placed=reconstructed.placed,
                geometry=located.geometry,
                edited=edit.views,
                cameras=reconstructed.cameras,
                gaussians=reconstructed.reconstruction.gaussians,
                first=first,
                rendered=rendered,
                measured=reconstructed.reconstruction.measured,
                flat=located.flat,
                fov_range=located.fov_range,
                edit=edit.verdict,
                half_way=half,
                first_half_way=first_half,
                reference=reference,
                components=_named(components),
            ),
        )
        made = reconstructed.reconstruction
        if inputs.scene is not None and made.kept is not None:
            told = _compared(inputs.scene, made)
            verdict = replace(
                verdict, reason=f"{verdict.reason.removesuffix('.')}; {told}."
            )
        selection = replace(selection, masks=reconstructed.masks)
        edit_verdict = _edit_verdict(
            inputs, selection, edit, rendered, cameras, half, components
        )
    return Judged(rendered, verdict, edit_verdict)


def _compared(scene: SceneInput, made: Reconstruction) -> str:
    """What an edit in place did to the Gaussians of the given scene, as a clause."""
    kept, before = made.kept, scene.views.scene.gaussians
    assert kept is not None
    count = int(kept.sum())
    others = made.gaussians.harmonics[0, :count] != before.harmonics[0, kept]
    repainted = int(others.flatten(1).any(1).sum())
    told = [f"{repainted:,} of {before.count:,} Gaussians changed colour"]
    if count < before.count:
        told.append(f"{before.count - count:,} were taken out")
    if made.gaussians.count > count:
        told.append(f"{made.gaussians.count - count:,} are guesses of what was behind")
    return ", ".join((*told, "all others are as they came"))


def _from_photos(
    corrected: ExposureCorrected,
    reconstructed: Reconstructed,
    gaussians: Gaussians,
    size: tuple[int, int],
    rasterizer: Rasterizer,
) -> tuple[Rendering, Rendering]:
    """The scene before any refiner, no larger than critics look, and the final one; drawn once
    where they are the same.
    """
    before, text = reconstructed.reconstruction.gaussians, "render input views"
    cameras = reconstructed.cameras.at(size)
    drawn = [(gaussians, cameras)]
    if gaussians is not before:
        drawn.insert(0, (before, cameras.at(_small(size))))
    shown = [
        corrected.undone(render_each(rasterizer, scene, cameras, text))
        for scene, cameras in drawn
    ]
    return shown[0], shown[-1]


def places_asked(photos: int) -> int:
    """From how many places a reference of so many photos is looked at."""
    return min(MOST_PLACES, max(FEWEST_PLACES, MOST_DRAWN // photos))


def _reference(
    geometry: Geometry,
    used: list[int],
    edited: Views,
    rasterizer: Rasterizer,
    most: int,
) -> Reference:
    """The first scene of the batch, as sharp as critics look, from `most` places half-way."""
    size = _small(edited.image_size)
    one, views = geometry.scene(0).at(size), edited.scene(0).at(size)
    if one.intrinsics is not None:
        views = replace(views, intrinsics=one.intrinsics[:, used])
    c2w, depths = one.c2w[:, used], one.depths[:, used]
    cameras = Cameras(c2w, views.intrinsics, size)
    scales = pixel_scales(depths, views.intrinsics, FOOTPRINT)
    opacities = torch.full_like(depths, 0.95)
    pixels = pixels_to_gaussians(views.images, depths, cameras, scales, opacities)
    half = None
    if len(used) > 1:
        half = seen_half_way(rasterizer, pixels, cameras, edited, most)
    return Reference(
        first=asking.render(rasterizer, pixels.from_view(0), cameras.select([0])),
        depths=depths[0, 0],
        half_way=half,
    )


def _named(components: Components) -> dict[str, str]:
    """The name of each component by the part of a run that it is."""
    found = {
        "editor": components.editor_names,
        "reconstructor": component_name(components.reconstructor),
        "refiner": " + ".join(map(component_name, components.refiners)),
        "rasterizer": component_name(components.rasterizer),
    }
    if components.uses_geometry:
        found["geometry"] = component_name(components.geometry_source)
    return found


def _small(size: tuple[int, int]) -> tuple[int, int]:
    """(height, width) at which critics look [pixels]."""
    share = min(1.0, HALF_WAY_SIZE / max(size))
    height, width = (max(1, round(share * side)) for side in size)
    return height, width


def _edit_verdict(
    inputs: Inputs,
    selection: SelectedRegions,
    edit: EditedPhotos,
    rendered: Rendering,
    cameras: Cameras,
    half: HalfWay | None,
    components: Components,
) -> EditVerdict | None:
    """The verdict on the edit, with what the scene tells of it."""
    if edit.verdict is None:
        return None
    count = components.edited_count(inputs.start)
    asked = edit_to_judge(inputs, selection, edit, components.tasks, count)
    whole = replace(asked, rendered=rendered, cameras=cameras, half_way=half)
    return asking.judge_edit(components.critic, whole)


def seen_half_way(
    rasterizer: Rasterizer,
    gaussians: Gaussians,
    cameras: Cameras,
    photos: Views | None = None,
    most: int | None = None,
) -> HalfWay:
    """One scene (batch 1) from half-way between each of its `photos` and the nearest one; of more
    than `most` such places, evenly chosen ones.
    """
    between, pairs = half_way(cameras.at(_small(cameras.image_size)))
    chosen = evenly(range(len(pairs)), most)
    between, pairs = between.select(chosen), tuple(pairs[one] for one in chosen)
    rendered = render_each(rasterizer, gaussians, between, "look between the photos")
    return HalfWay(rendered, between, pairs, photos)
