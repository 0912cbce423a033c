"""A scene in any unit and anywhere survives the formats that hold some positions only, or is
refused; what was done is said and undone.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_outputs.placing import fitting, placed

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Gaussians
from edit3r.kit.scenes.placement import FilePlacement, placed_back
from edit3r.kit.scenes.reading import load_scene

SIZE = 0.06
FORMS = ["spz", "spz4", "sog", "compressed-ply"]


def scene(unit=1.0, shift=(0.0, 0.0, 0.0), count=60):
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(1, count, 3, generator=generator) * 2 - 1
    means = (means.double() * unit + torch.tensor(shift).double()).float()
    return Gaussians(
        means,
        torch.full((1, count, 3), SIZE * unit),
        torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        torch.full((1, count), 0.9),
        torch.zeros(1, count, 1, 3),
    )


def written(tmp_path, made, form):
    """The scene as it comes back, and what was said."""
    writer = edit3r.build("writer", form)
    path = tmp_path / writer.offer.component.file_name("s")
    with collecting(Report()) as report:
        writer.write(path, SceneToWrite(made))
    return load_scene(path), report


def off(made, back):
    """The largest distance from a Gaussian to the nearest that came back, in its own sizes."""
    apart = torch.cdist(made.means[0].double(), back.means[0].double())
    return float((apart.amin(1) / made.scales[0, :, 0]).max())


PLACES = {
    "metres": (1.0, (0, 0, 4)),
    "millimetres": (1000.0, (0, 0, 4000)),
    "kilometres": (1e-3, (0, 0, 0.004)),
    "hundredths": (0.01, (0, 0, 0.04)),
    "moved": (1.0, (3000, 0, 0)),
    "huge": (1e6, (0, 0, 4e6)),
    "tiny": (1e-6, (0, 0, 0)),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("place", PLACES)
def test_a_scene_of_any_unit_comes_back(tmp_path, form, place):
    pytest.importorskip("gaussforge", reason="needs the extra export")
    made = scene(*PLACES[place])
    back, report = written(tmp_path, made, form)
    assert back.count == made.count
    assert off(made, back) < 0.15
    np.testing.assert_allclose(back.scales / made.scales[0, 0, 0], 1, atol=0.05)
    if form.startswith("spz") and place != "metres":
        assert "in the file it is" in report.notes["spz.unit"]
    if place == "metres":
        assert not report.notes and not report.warnings


@pytest.mark.parametrize("form", FORMS)
def test_the_coordinates_of_a_map_come_back(tmp_path, form):
    """float32 itself has steps of 0.5 there: the Gaussians are as large as a house."""
    pytest.importorskip("gaussforge", reason="needs the extra export")
    made = scene(200.0, (500_000, 5_600_000, 100))
    back, _ = written(tmp_path, made, form)
    assert off(made, back) < 0.15


def test_a_few_far_away_are_left_out_and_all_else_keeps_its_steps():
    made = scene(count=2000)
    means = made.means.clone()
    means[0, :9, 2] = 5e8
    kept, placement = fitting(replace(made, means=means), "spz")
    assert torch.equal(kept.means, made.means[:, 9:])
    assert placement == FilePlacement()
    means[0, :11, 2] = 5e8  # more than 0.5 % on one side
    with pytest.raises(InputError, match="cannot hold this scene"):
        fitting(replace(made, means=means), "spz")


def test_what_nobody_sees_stays_where_nothing_is_left_out():
    made = scene(count=100)
    opacities = made.opacities.clone()
    opacities[0, :30] = 0
    made = replace(made, opacities=opacities)
    kept, _ = fitting(made, "spz")
    assert kept is made


def test_what_fits_in_no_unit_is_refused():
    made = scene(1e-6, count=60)
    spread = replace(made, means=made.means * 1e11)
    with pytest.raises(InputError, match="spz: cannot hold this scene in any unit"):
        fitting(spread, "spz")


def test_a_placement_is_undone():
    made = scene(3.0, (100, 200, 300))
    where = FilePlacement(0.25, (96.0, 200.0, 304.0))
    back = placed_back(placed(made, where), where)
    torch.testing.assert_close(back.means, made.means)
    torch.testing.assert_close(back.scales, made.scales)
