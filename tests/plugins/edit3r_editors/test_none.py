import torch

from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest, Views
from edit3r.loading.registry import build

VIEWS = Views(torch.rand(1, 2, 3, 4, 5), torch.eye(3).expand(1, 2, 3, 3))


def test_none_returns_the_very_photos():
    assert build("editor", "none").edit(VIEWS, EditRequest("")) is VIEWS


def test_none_says_that_a_prompt_is_not_used():
    with collecting(Report()) as report:
        build("editor", "none").edit(VIEWS, EditRequest("paint it red"))
    assert "'paint it red' is not used" in report.warnings[0]
