"""Marks of one photo are those made on it, all of them."""

from edit3r_select.marks import Marks, marks_on

from edit3r.contract.interfaces import Selection


def test_a_photo_has_its_own_marks_of_each_kind():
    boxes = {0: (0.1, 0.1, 0.2, 0.2), 2: (0.3, 0.4, 0.5, 0.1)}
    lines = [((0.1, 0.2), (0.3, 0.4)), ((0.5, 0.6),), ((0.7, 0.8), (0.9, 1.0))]
    selection = Selection(
        positive=((2, 0.1, 0.2), (0, 0.3, 0.4), (2, 0.5, 0.6)),
        negative=((0, 0.7, 0.8), (2, 0.9, 1.0)),
        boxes=boxes,
        strokes=((2, lines[0]), (0, lines[1]), (2, lines[2])),
    )
    assert marks_on(selection, 2) == Marks(
        ((0.1, 0.2), (0.5, 0.6)),
        ((0.9, 1.0),),
        boxes[2],
        stroke=(*lines[0], *lines[2]),
    )
    assert marks_on(selection, 1) == Marks() and not Marks().says_where
    for marks in (
        Marks(positive=((0, 0),)),
        Marks(stroke=((0, 0),)),
        Marks(box=boxes[0]),
    ):
        assert marks.says_where
