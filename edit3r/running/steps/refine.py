"""Step 6: what the refiners make of the Gaussians."""

from dataclasses import replace

from edit3r.contract.component import component_name
from edit3r.contract.interfaces import ComparesWithBefore, RefineInputs
from edit3r.contract.reporting import say, stage
from edit3r.contract.types import Gaussians, Views
from edit3r.kit import asking
from edit3r.kit.compute.layers import bilinear
from edit3r.kit.geometry.maps import composite
from edit3r.kit.rendering import CheckedRasterizer
from edit3r.running.components import Components
from edit3r.running.records import ExposureCorrected, Reconstructed


def refine(
    corrected: ExposureCorrected, reconstructed: Reconstructed, components: Components
) -> Gaussians:
    """Apply the refiners.

    Editing again, `before` is an earlier run's scene and has been refined: the refiners follow in
    their order. In a first run it has not: refiners that compare with it come first, where both
    scenes have one Gaussian a pixel and fit without gaps, and the others refine all.
    """
    again = components.edits_again
    refiners = components.refiners
    if len(refiners) < len(components.config.all_refiners()):
        say(
            "refine.left_out",
            "the reconstructor's Gaussians are kept as they are, because it resolves edits that "
            "disagree by itself; --gaussians and --refine still change them",
        )
    if not again:
        first = [one for one in refiners if isinstance(one, ComparesWithBefore)]
        others = [one for one in refiners if not isinstance(one, ComparesWithBefore)]
        refiners = (*first, *others)
    first_alone = components.config.edit_views == "first"
    inputs = RefineInputs(
        cameras=reconstructed.cameras,
        views=corrected.edited.select([0])
        if first_alone
        else _as_fused(corrected.edited, reconstructed),
        rasterizer=CheckedRasterizer(components.rasterizer),
        masks=reconstructed.masks,
        before=None if reconstructed.before is None else reconstructed.before.gaussians,
        seed=components.config.seed,
    )
    gaussians = reconstructed.reconstruction.gaussians
    for refiner in refiners:
        compares = isinstance(refiner, ComparesWithBefore)
        if compares and inputs.before is None:
            continue
        with stage(component_name(refiner)):
            gaussians = asking.refine(refiner, gaussians, inputs)
        if compares and not again:
            inputs = replace(inputs, before=None)
    return gaussians


def _as_fused(edited: Views, reconstructed: Reconstructed) -> Views:
    """The edited views as the scene shows them: own edits would make them disagree again.

    Outside the masks nothing may change, so there the fused edit does not count either.
    """
    fusion = reconstructed.reconstruction.fusion
    if fusion is None:
        return edited
    change = bilinear(fusion.flatten(0, 1), edited.image_size).view_as(edited.images)
    fused = (edited.images + change).clamp(0, 1)
    if reconstructed.masks is not None:
        fused = composite(edited.images, fused, reconstructed.masks)
    return replace(edited, images=fused)
