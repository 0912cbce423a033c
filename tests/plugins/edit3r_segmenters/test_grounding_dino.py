"""Grounding DINO on a tiny random model, and its answers put in order."""

import pytest
import torch
from edit3r_segmenters.grounding_dino import as_question, ranked

import edit3r
from edit3r.contract.errors import MissingDependencyError, PromptError


@pytest.fixture(scope="module")
def build(dino_folder):
    def build(**settings):
        settings = {"model": str(dino_folder), "local_files_only": True, **settings}
        return edit3r.build("detector", "grounding-dino", **settings)

    return build


def test_boxes_lie_in_the_picture_best_first(build, photo):
    found = build(box_threshold=0.0, text_threshold=0.0).detect(photo, "the bike")
    assert found
    assert [d.score for d in found] == sorted((d.score for d in found), reverse=True)
    for detection in found:
        x, y, width, height = detection.box
        assert (
            0 <= x < x + width <= 80
            and 0 <= y < y + height <= 60
            and 0 <= detection.score <= 1
        )


@pytest.mark.slow
def test_labels_are_words_of_the_text(build, photo):
    labels = {
        d.label
        for d in build(box_threshold=0.0, text_threshold=0.0).detect(photo, "the bike")
    }
    assert labels == {"the bike"}


def test_text_and_threshold_decide_what_is_found(build, photo):
    detector = build(box_threshold=0.0)
    assert detector.detect(photo, "the bike") != detector.detect(
        photo, "a door. a chair."
    )
    assert build(box_threshold=1.0).detect(photo, "the bike") == ()


def test_a_question_is_lower_case_and_closed():
    assert as_question("  The  Bike ") == "the bike."
    assert as_question("a door. a chair.") == "a door. a chair."
    with pytest.raises(PromptError, match="asked for nothing"):
        as_question("  ")


def test_corner_boxes_are_clipped_sorted_and_empty_ones_dropped():
    boxes = torch.tensor([[-5.0, 10, 30, 90], [0, 0, 10, 10], [90, 0, 95, 10]])
    found = ranked(["a", "b", "c"], torch.tensor([0.4, 0.9, 0.8]), boxes, (60, 80))
    assert [(d.label, d.box) for d in found] == [
        ("b", (0, 0, 10, 10)),
        ("a", (0, 10, 30, 50)),
    ]


def test_missing_weights_are_a_sentence(photo):
    with pytest.raises(
        MissingDependencyError, match=r"edit3r weights get grounding-dino"
    ):
        edit3r.build("detector", "grounding-dino", local_files_only=True).detect(
            photo, "the bike"
        )
