"""edit3r's contract of a reconstructor on a script without edit3r; run where edit3r and this
package are installed.
"""

import sys
from pathlib import Path

import pytest
import torch

import edit3r
from edit3r.contract.errors import RunError
from edit3r_testing import ReconstructorContract
from edit3r_testing.scenes import photograph

TOOL = Path(__file__).with_name("tool.py")
COMMAND = f"'{sys.executable}' '{TOOL}' {{photos}} {{result}}"


class TestProgramKeepsTheContract(ReconstructorContract):
    component = "program"
    settings = {"command": COMMAND}  # noqa: RUF012


def test_one_gaussian_a_pixel_in_the_colour_of_the_photo():
    views = photograph(2, (32, 48)).views
    made = edit3r.build("reconstructor", "program", command=COMMAND)(views).gaussians
    shown = (
        (made.harmonics[0, :, 0] * 0.28209479 + 0.5)
        .view(2, 32, 48, 3)
        .permute(0, 3, 1, 2)
    )
    assert torch.allclose(shown, views.images[0], atol=0.003)  # through PNG, 8 bits


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("no-such-program {photos}", "No such file"),
        (
            f"'{sys.executable}' -c \"import sys; sys.exit('the model is not there')\"",
            "the model is not there",
        ),
        ("", "failed"),
    ],
)
def test_what_the_program_cannot_do_is_told_in_its_words(command, told):
    with pytest.raises(RunError, match=told):
        edit3r.build("reconstructor", "program", command=command)(
            photograph(2, (32, 48)).views
        )
