"""Which found things are asked about before anything is edited."""

from types import SimpleNamespace

import pytest
import torch

from edit3r.contract.errors import QuestionError
from edit3r.contract.interfaces import Candidate, Selected
from edit3r.running.records import SelectedRegions
from edit3r.running.steps.select import ASKED, require_answer


def asked_about(confidence):
    """Whether a run asks about what words found on one photo."""
    mask = torch.ones(4, 6)
    found = Selected(
        mask[None, None],
        ("words",),
        confidence=confidence,
        candidates=(Candidate(0, mask, 0.5, 1),),
    )
    config = SimpleNamespace(guess=False, set_by_the_user=dict)
    components = SimpleNamespace(config=config, reader=None, hiding=())
    selection = SelectedRegions(selected=(found,))
    try:
        require_answer(SimpleNamespace(), selection, components)
    except QuestionError:
        return True
    return False


@pytest.mark.parametrize(
    ("confidence", "asks"), [(None, False), (ASKED, False), (0.9 * ASKED, True)]
)
def test_only_what_words_found_unsurely_is_a_question(confidence, asks):
    """A selector that cannot tell how sure it is, is not doubted for that."""
    assert asked_about(confidence) == asks
