"""Which found things are asked about before anything is edited."""

from types import SimpleNamespace

import pytest
import torch

from edit3r.contract.errors import InputError, QuestionError
from edit3r.contract.instructions import Colour, Instruction, Target
from edit3r.contract.interfaces import Candidate, EditsRegions, Selected
from edit3r.contract.types import Views
from edit3r.running.records import SelectedRegions
from edit3r.running.steps.select import ASKED, _regions, require_answer


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


def regions(instructions=(), editor=None, **inputs):
    """The regions on two scenes of two pictures, on the left red and on the right blue."""
    images = torch.zeros(2, 2, 3, 20, 24)
    images[:, :, 0, :, :9] = images[:, :, 2, :, 9:] = 0.8
    views = Views(images, torch.eye(3).expand(2, 2, 3, 3))
    given = {
        "photos": None,
        "start": views,
        "masks": None,
        "marked": None,
        "things": {},
    }
    components = SimpleNamespace(
        tasks=[SimpleNamespace(editor=editor, instructions=instructions)],
        config=SimpleNamespace(prompt=""),
        chose_segmenter=False,
    )
    return _regions(SimpleNamespace(**given | inputs), SimpleNamespace(), components)


def test_where_nothing_says_which_thing_is_meant_nothing_is_looked_for():
    it = Instruction("remove", Target("marked"))
    assert regions((it,)).masks is None, "the editor changes whole pictures"
    with pytest.raises(InputError, match="not clear which object"):
        regions((it,), EditsRegions())


def test_given_masks_are_taken_and_narrowed_to_the_colour_that_is_named():
    masks = torch.ones(2, 2, 20, 24)
    masks[1, :, :12] = 0
    blue = Target("named", "thing", part=Colour("blue", (0.0, 0.0, 0.8)))
    found = regions(
        (Instruction("remove", Target()), Instruction("remove", blue)), masks=masks
    )
    assert torch.equal(found.masks, masks) and torch.equal(found.regions[0], masks)
    assert torch.equal(found.regions[1, ..., 12:] > 0.5, masks[..., 12:] > 0.5)
    assert not found.regions[1, ..., :7].any()
    with pytest.raises(
        InputError, match=r"views' size \[2, 2, 20, 24\], got \[2, 2, 24, 20\]"
    ):
        regions(masks=masks.mT)
