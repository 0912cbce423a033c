"""EXIF is believed of the lens as long as the photos fit together with it."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Views
from edit3r.running.records import Inputs, Located
from edit3r.running.steps.locate import locate

K = torch.eye(3).expand(1, 2, 3, 3)
PHOTOS = Views(torch.rand(1, 2, 3, 8, 8), K)


def geometry(**fields):
    ones = torch.ones(1, 2, 8, 8)
    poses = torch.eye(4).expand(1, 2, 4, 4)
    return Geometry(poses, ones, ones, torch.ones(1, 2).bool(), **fields)


class Finds:
    """A matcher that finds one geometry by a known lens, another without; None: neither."""

    def __init__(self, known, unknown):
        self.known, self.unknown = known, unknown

    def match(self, views):
        answer = self.unknown if views.assumed else self.known
        if answer is None:
            raise MatchingError("too few points")
        return answer


def located(source, known, unknown):
    """What becomes of photos whose lens `source` tells, by what is found with it and without."""
    records = tuple(SimpleNamespace(intrinsics_source=source) for _ in range(2))
    parts = SimpleNamespace(
        uses_geometry=True,
        config=SimpleNamespace(exposure="own"),
        geometry_source=Finds(known, unknown),
    )
    inputs = Inputs(photos=PHOTOS, start=replace(PHOTOS), files=records)
    with collecting(Report()) as report:
        return *locate(inputs, parts), report.notes


EXIF = "EXIF 35 mm equivalent (26 mm)"
READ = geometry(intrinsics=K)


@pytest.mark.parametrize("known", [None, geometry(contradicting_fov=30.0)])
def test_exif_that_does_not_fit_the_photos_is_not_believed(known):
    inputs, _, notes = located(EXIF, known, READ)
    assert inputs.photos.assumed == inputs.start.assumed == (True, True)
    assert "lens.exif" in notes and "read from the photos" in notes["lens.source"][0]


@pytest.mark.parametrize(
    "source, known, unknown",
    [
        (EXIF, geometry(), READ),  # it fits
        ("--fov 60", geometry(contradicting_fov=30.0), READ),  # the user knows
    ],
)
def test_else_it_is(source, known, unknown):
    inputs, _, notes = located(source, known, unknown)
    assert inputs.photos.assumed == () and notes["lens.source"] == [source]


def test_photos_that_fit_with_no_lens_end_the_run_before_anything_is_edited():
    with pytest.raises(MatchingError, match="too few points"):
        located(EXIF, None, None)


def test_a_single_pass_asks_nobody_for_geometry_and_says_the_lens_that_it_is_given():
    records = tuple(SimpleNamespace(intrinsics_source="60 degrees") for _ in range(2))
    photos = replace(PHOTOS, assumed=(True, True))
    parts = SimpleNamespace(uses_geometry=False)
    with collecting(Report()) as report:
        _, found = locate(Inputs(photos, photos, records), parts)
    assert found == Located() and report.notes["lens.source"] == ["60 degrees"]


def test_fields_that_explain_the_photos_alike_go_on_to_the_verdict():
    unsure = replace(READ, fov_range=(30.0, 55.0))
    _, found, notes = located(EXIF, geometry(contradicting_fov=30.0), unsure)
    assert found.fov_range == (30.0, 55.0) and notes["lens.alike"] == [30.0, 55.0]


@pytest.mark.parametrize("assumed", [(True, True), (True, False), ()])
def test_photos_of_one_plane_are_told_only_where_nobody_knows_a_lens(assumed):
    photos = replace(PHOTOS, assumed=assumed)
    parts = SimpleNamespace(
        uses_geometry=True,
        config=SimpleNamespace(exposure="own"),
        geometry_source=Finds(geometry(), geometry()),
    )
    with collecting(Report()):
        _, found = locate(Inputs(photos, photos), parts)
    assert found.flat == any(assumed)
