"""Views that are not used, or not placed, leave every record of a run."""

import torch

from edit3r.contract.interfaces import Candidate, Geometry, Selected
from edit3r.contract.types import Views
from edit3r.kit.geometry.exposure import Exposure, ExposureOfEdit
from edit3r.running.geometry import GeometryAnswer
from edit3r.running.records import (
    EditedPhotos,
    ExposureCorrected,
    Inputs,
    Located,
    SelectedRegions,
)

KEPT = [0, 2]
BY_VIEW = torch.arange(3.0)
MAPS = BY_VIEW.view(1, 3, 1, 1).expand(1, 3, 4, 5)
VIEWS = Views(
    MAPS[:, :, None].expand(1, 3, 3, 4, 5) / 3, torch.eye(3).expand(1, 3, 3, 3)
)


def told(maps):
    """Of which views the maps are."""
    return maps[0, :, 0, 0].tolist()


def test_inputs_of_some_views():
    some = Inputs(
        VIEWS, VIEWS, files=("a", "b", "c"), masks=MAPS, things={"bike": MAPS[0]}
    ).select(KEPT)
    assert some.files == ("a", "c") and told(some.masks) == KEPT
    assert told(some.things["bike"][None]) == KEPT
    assert torch.equal(some.photos.images, VIEWS.images[:, KEPT])
    assert torch.equal(some.start.images, VIEWS.images[:, KEPT])


def test_what_was_located_of_some_views():
    gain = BY_VIEW.view(1, 3, 1, 1, 1)
    exposure = Exposure(gain, gain + 1)
    edit = ExposureOfEdit(exposure, Exposure(gain + 2, gain), MAPS)
    corrected = ExposureCorrected(VIEWS, VIEWS, edit).select(KEPT)
    assert corrected.exposure.photos.gain.flatten().tolist() == KEPT
    assert corrected.exposure.edit.gain.flatten().tolist() == [2, 4]
    assert told(corrected.exposure.region) == KEPT
    for views in (corrected.photos, corrected.edited):
        assert torch.equal(views.images, VIEWS.images[:, KEPT])
    poses = torch.eye(4).expand(1, 3, 4, 4)
    placed = torch.tensor([[True, False, True]])
    geometry = Geometry(poses, MAPS, 1 + MAPS, placed)
    some = Located(GeometryAnswer(geometry, "why"), geometry, exposure=exposure)
    some = some.select(KEPT)
    assert some.answer.problem == "why"
    for one in (some.geometry, some.to_build_on):
        assert told(one.depths) == KEPT and told(one.confidence) == [1, 3]
        assert one.registered.tolist() == [[True, True]] and one.c2w.shape[1] == 2
    assert some.exposure.gain.flatten().tolist() == KEPT
    assert some.exposure.offset.flatten().tolist() == [1, 3]
    assert Located().select(KEPT) == Located()


def test_what_was_selected_and_edited_on_some_views():
    candidates = tuple(
        Candidate(view, MAPS[0, view], 0.5, 3 - view) for view in range(3)
    )
    found = Selected(
        MAPS[0, :, None], ("words", "geometry", "marked"), (), 0.5, candidates
    )
    some = SelectedRegions(
        MAPS,
        MAPS[None].repeat(2, 1, 1, 1, 1),
        selected=(found,),
        things={"bike": MAPS[0]},
    ).select(KEPT)
    (left,) = some.selected
    assert left.how == ("words", "marked") and told(left.masks[None, :, 0]) == KEPT
    assert [(one.view, one.number) for one in left.candidates] == [(0, 3), (1, 1)]
    assert told(some.masks) == told(some.regions[1]) == KEPT
    assert told(some.things["bike"][None]) == KEPT
    edited = EditedPhotos(VIEWS, ("a fault",)).select(KEPT)
    assert torch.equal(edited.views.images, VIEWS.images[:, KEPT])
    assert edited.faults == ("a fault",)
