"""Marks and what was typed, in a file."""

import pytest
import torch
from edit3r_app.draft import Draft, Mark, Step, read_draft, write_draft
from edit3r_app.jobs import JobsFolder

from edit3r.contract.errors import InputError
from edit3r.contract.types import Views


@pytest.fixture
def folder(tmp_path):
    return JobsFolder(tmp_path)


def test_a_draft_survives_a_restart(folder):
    draft = Draft(
        marks=[
            Mark("add", "a", [(0.5, 0.5)]),
            Mark("box", "b", [(0.1, 0.1), (0.3, 0.3)]),
            Mark("erase", "b", [(0.2, 0.3), (0.4, 0.3)], 0.04),
            Step("larger", 1),
            Step("invert"),
        ],
        words="sky",
        form={"prompt": "gold"},
        named={"door": [Mark("add", "a", [(0.5, 0.5)])]},
    )
    write_draft(folder, "bear", draft)
    assert read_draft(JobsFolder(folder.root), "bear") == draft


@pytest.mark.parametrize(
    "mark",
    [
        '{"kind": "add", "photo": "a", "places": []}',
        '{"kind": "add", "photo": "a", "places": [["x", 1]]}',
        '{"kind": "add", "photo": "a", "places": [[2, 0.5]]}',
        '{"kind": "paint", "photo": "a", "places": [[NaN, 0.5]], "radius": 0.1}',
        '{"kind": "cut", "photo": "a", "places": [[0.5, 0.5]]}',
    ],
)
def test_a_damaged_draft_is_an_empty_one(folder, mark):
    file = folder.beside("bear") / "draft.json"
    for content in ("", "[]", f'{{"marks": [{mark}]}}'):
        file.write_text(content)
        assert read_draft(folder, "bear") == Draft()
    file.write_text('{"marks": [{"kind": "add", "photo": "a", "places": [[1, 0]]}]}')
    assert read_draft(folder, "bear").marks == [Mark("add", "a", [(1, 0)])]


@pytest.mark.parametrize(
    "marks",
    [
        [Mark("add", "a", [(0.5, 0.5)])] * 201,
        [Mark("paint", "a", [(0.5, 0.5)] * 4001, 0.05)],
    ],
)
def test_more_marks_than_anybody_makes_are_refused(folder, marks):
    with pytest.raises(InputError, match="more than 200 marks"):
        write_draft(folder, "bear", Draft(marks))
    assert read_draft(folder, "bear") == Draft()


def test_only_what_says_which_thing_is_meant_selects():
    remove = Mark("remove", "a", [(0.5, 0.5)])
    assert not Draft([remove]).selects
    assert Draft([remove, Mark("add", "a", [(0.5, 0.5)])]).selects
    assert Draft(words="sky").selects


def test_marks_stay_with_their_photo_and_pass_over_one_that_is_gone():
    views = Views(
        torch.zeros(1, 1, 3, 40, 60), torch.eye(3).expand(1, 1, 3, 3), names=("b",)
    )
    draft = Draft(
        [
            Mark("add", "a", [(0.1, 0.1)]),
            Mark("add", "b", [(0.5, 0.5)]),
            Mark("box", "b", [(0.75, 0.5), (0.25, 1)]),
            Mark("paint", "b", [(0.2, 0.5), (0.8, 0.5)], 0.05),
        ]
    )
    selection = draft.selection(views)
    assert selection.positive == ((0, 0.5, 0.5),)
    assert selection.boxes == {0: (0.25, 0.5, 0.5, 0.5)}
    rows = selection.added[0][:, 30].nonzero()[:, 0]
    assert rows.float().mean() == 20  # where the stroke is
    assert 5 <= len(rows) <= 8  # 2 x 0.05 of 60 pixels


def test_steps_add_up_and_are_taken_back_one_by_one():
    draft = Draft(words="sky")
    for step in (Step("larger", 1), Step("larger", -1), Step("larger", -1)):
        draft.take(step)
    draft.take(Step("invert"))
    draft.take(Step("grow", 1))
    draft.take(Step("grow", 12))  # typed on: one step
    assert draft.outline == {"larger": -1, "candidate": 1, "grow": 12, "invert": True}
    draft.take(Step("invert"))
    assert not draft.outline["invert"]
    draft.take_back()
    draft.take_back()
    assert draft.outline == {"larger": -1, "candidate": 1, "grow": 0, "invert": True}
    draft.take_back()
    draft.take_back()
    assert draft.outline == {"larger": 0, "candidate": 1, "grow": 0, "invert": False}
    draft.take_back()
    draft.take_back()
    draft.take_back()
    assert (draft.marks, draft.words) == ([], "")


def test_what_was_taken_back_can_be_taken_again_until_something_new_is_marked():
    first, second = Mark("add", "a", [(0.1, 0.2)]), Mark("add", "a", [(0.3, 0.2)])
    draft = Draft()
    for mark in (first, second):
        draft.take(mark)
    draft.take_back()
    draft.take_back()
    draft.take_again()
    assert draft.marks == [first]
    draft.take(first)
    draft.take_again()
    assert draft.marks == [first, first]


def test_a_stroke_is_looked_for_and_an_exact_box_is_taken_as_it_is():
    views = Views(torch.zeros(1, 1, 3, 40, 40), torch.eye(3)[None, None], ("a",))
    line = [(0.1, 0.1), (0.2, 0.2), (0.3, 0.2)]
    chosen = Draft(
        [Mark("stroke", "a", line), Mark("exact", "a", [(0.5, 0.5), (0.75, 1)])]
    )
    found = chosen.selection(views)
    assert chosen.selects
    assert found.strokes == ((0, tuple(line)),)
    assert found.regions == ((0, (0.5, 0.5, 0.25, 0.5)),)


def test_a_lasso_takes_what_it_goes_around_and_carves_it_away():
    views = Views(torch.zeros(1, 1, 3, 40, 40), torch.eye(3)[None, None], ("a",))
    around = [(0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75)]
    assert not Draft([Mark("carve", "a", around)]).selects
    chosen = Draft([Mark("lasso", "a", around), Mark("carve", "a", around[:3])])
    found = chosen.selection(views)
    assert chosen.selects
    assert found.added[0].sum() == 21 * 21 and found.added[0][20, 20] == 1
    assert found.removed[0][12, 28] == 1 and found.removed[0][28, 12] == 0


def test_a_candidate_is_chosen_for_the_things_of_its_sentence():
    draft = Draft(form={"prompt": "paint the tractor red"})
    draft.take(Step("candidate", 2))
    for sentence, chose in (
        ("paint the tractor blue", True),
        ("paint the chair blue", False),
        ("paint the tractor green", True),
    ):
        draft.form["prompt"] = sentence
        assert draft.chose == chose, sentence
        assert draft.outline["candidate"] == (2 if chose else 1)


def test_the_last_candidate_that_was_picked_counts():
    draft = Draft([Mark("add", "a", [(0.1, 0.2)])])
    for number in (2, 3):
        draft.take(Step("candidate", number))
    assert len(draft.marks) == 2 and draft.outline["candidate"] == 3
