"""Things that nobody marked: found, confirmed by a second photo, named, kept apart."""

import pytest
import torch
from edit3r_objects.finding import MOST, Finders, find_things

from edit3r import Cameras
from edit3r.contract.interfaces import (
    Detection,
    Detector,
    MaskLogits,
    Proposal,
    Segmenter,
)
from edit3r.running import usual_selector

SIZE = 60
WALL, SHIFT = 4.0, 0.1  # depth behind everything; how far the second camera stands
COLOURS = {"near": 0.2, "far": 0.4, "gap": 0.6, "only here": 0.8}


def made(*things):
    """Two exact views: name, depth, and x, y, width, height in the first one."""
    images, depths = torch.zeros(2, 3, SIZE, SIZE), torch.full((2, SIZE, SIZE), WALL)
    for name, depth, x, y, width, height in things:
        for view in (0,) if name == "only here" else (0, 1):
            left = x - view * round(SHIFT * SIZE / depth)
            place = (slice(y, y + height), slice(left, left + width))
            images[(view, slice(None), *place)] = COLOURS[name]
            depths[(view, *place)] = depth
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = SHIFT
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).repeat(1, 2, 1, 1)
    return images, depths, Cameras(c2w, lens, (SIZE, SIZE))


@pytest.fixture(autouse=True)
def sharp(monkeypatch):
    """Outlines are those of the masks, which no picture softens."""
    monkeypatch.setattr(
        "edit3r_select.answering.soft_edged",
        lambda image, inside: torch.from_numpy(inside).to(image),
    )


class OneColour(Segmenter):
    """All that has the colour of the click, or of the middle of the box."""

    def __init__(self):
        pass

    def masks(self, image, clicks, box=None, before=None):
        x, y, across, down = box or (*clicks[0][0], 0, 0)
        row, column = int((y + down / 2) * SIZE), int((x + across / 2) * SIZE)
        return MaskLogits((image[:1] == image[0, row, column]) * 8.0 - 4)


class Calls(Detector):
    """Gives a label to the box of each colour; another one in each photo where it says so."""

    def __init__(self, labels):
        self.labels = labels  # by name: of the first photo, of the second

    def detect(self, image, text):
        assert text == ""
        found = []
        for name, labels in self.labels.items():
            proposal = Proposal((image[0] == COLOURS[name]).float())
            second = image[0, 0, 0] > 0
            found.append(Detection(labels[int(second)], 0.5, proposal.box))
        return tuple(found)


def found(scene, labels=None):
    images, depths, cameras = scene
    images[1, :, 0, 0] = 0.01  # tells the detector which photo it sees
    detector = None if labels is None else Calls(labels)
    return find_things(
        images, depths, cameras, Finders(usual_selector(OneColour()), detector)
    )


SQUARE = ("near", 1.0, 24, 24, 16, 16)


def test_a_thing_is_found_on_both_photos_where_it_stands():
    images, depths, cameras = made(SQUARE)
    (thing,) = found((images, depths, cameras))
    assert thing.confirmed and thing.name == ""
    assert torch.equal(thing.masks > 0.5, depths < WALL)


@pytest.mark.parametrize(
    ("labels", "name"), [(("cup", "cup"), "cup"), (("sheep", "bear"), "")]
)
def test_a_word_is_taken_where_both_photos_say_it(labels, name):
    (thing,) = found(made(SQUARE), {"near": labels})
    assert thing.name == name


def test_what_the_other_photo_does_not_show_comes_last():
    things = found(made(("only here", 1.0, 10, 10, 20, 20), ("far", 2.0, 40, 40, 9, 9)))
    assert [thing.confirmed for thing in things] == [True, False]


def test_a_gap_that_is_looked_through_is_no_thing():
    images, depths, cameras = made(
        ("near", 1.0, 22, 22, 24, 24), ("gap", 3.0, 27, 27, 8, 8)
    )
    things = found((images, depths, cameras))
    assert len(things) == 1 and not things[0].masks[0, 30, 30]


def test_the_wall_is_no_thing_and_one_photo_is_enough():
    assert found(made()) == []
    images, depths, cameras = made(SQUARE)
    tools = Finders(usual_selector(OneColour()), None)
    (thing,) = find_things(images[:1], depths[:1], cameras.select([0]), tools)
    assert not thing.confirmed and len(thing.masks) == 1 <= MOST
