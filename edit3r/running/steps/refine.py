"""Step 6: what the refiners make of the Gaussians."""

from dataclasses import replace

from edit3r.contract.component import component_name
from edit3r.contract.interfaces import ComparesWithBefore, RefineInputs, Refiner
from edit3r.contract.reporting import say, stage
from edit3r.contract.types import Gaussians, Views
from edit3r.kit.checks import check_refinement, errors_named_after
from edit3r.kit.compute.layers import bilinear
from edit3r.kit.geometry.maps import composite
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene, known_cameras


def refine(scene: Scene, parts: Parts) -> Scene:
    """Apply the refiners.

    Editing again, `before` is an earlier run's scene and has been refined: the refiners follow in
    their order. In a first run it has not: refiners that compare with it come first, where both
    scenes have one Gaussian a pixel and fit without gaps, and the others refine all.
    """
    again = parts.edits_again
    refiners = parts.refiners
    if len(refiners) < len(parts.config.all_refiners()):
        say(
            "refine.left_out",
            "the reconstructor's Gaussians are kept as they are, for they settle disagreeing edits "
            "by themselves; --gaussians and --refine change them nevertheless",
        )
    if not again:
        first = [one for one in refiners if isinstance(one, ComparesWithBefore)]
        others = [one for one in refiners if not isinstance(one, ComparesWithBefore)]
        refiners = (*first, *others)
    gaussians = scene.gaussians
    for refiner in refiners:
        compares = isinstance(refiner, ComparesWithBefore)
        if compares and scene.before is None:
            continue
        gaussians = _refined(refiner, gaussians, scene, parts)
        if compares and not again:
            scene = replace(scene, before=None)
    return replace(scene, gaussians=gaussians)


def _refined(
    refiner: Refiner, gaussians: Gaussians, scene: Scene, parts: Parts
) -> Gaussians:
    first_alone = parts.config.edit_views == "first"
    inputs = RefineInputs(
        cameras=known_cameras(scene.reconstruction),
        views=scene.edited.select([0]) if first_alone else _as_fused(scene),
        rasterizer=parts.rasterizer,
        masks=scene.masks,
        before=None if scene.before is None else scene.before.gaussians,
        seed=parts.config.seed,
        ignored=scene.passing,
    )
    with stage(component_name(refiner)), errors_named_after(refiner):
        answer = refiner(gaussians, inputs)
    check_refinement(refiner, scene.gaussians, answer)
    return answer


def _as_fused(scene: Scene) -> Views:
    """The edited views as the scene shows them: own edits would make them disagree again.

    Outside the masks nothing may change, so there the fused edit does not count either.
    """
    edited = scene.in_one_light(scene.edited)
    fusion = scene.reconstruction.fusion
    if fusion is None:
        return edited
    change = bilinear(fusion.flatten(0, 1), edited.image_size).view_as(edited.images)
    fused = (edited.images + change).clamp(0, 1)
    if scene.masks is not None:
        fused = composite(edited.images, fused, scene.masks)
    return replace(edited, images=fused)
