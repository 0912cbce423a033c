"""Segmenter `auto`: SAM2 where its weights are at hand, a smaller SAM or `grabcut` otherwise, and
the run says which.
"""

import pytest
import torch
from edit3r_segmenters import SAM2_ONNX

import edit3r
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.cache import identity
from edit3r.running.config import DEFAULTS

CLICK = [((0.3, 0.5), True)]


def test_without_weights_a_click_is_answered_by_grabcut_and_the_essentials_are_named(
    at_hand, photo
):
    with collecting(Report()) as report:
        found = edit3r.build("segmenter", "auto").masks(photo, CLICK)
    assert report.notes["segmenter.picked"] == "grabcut"
    assert "edit3r weights get essentials" in report.warnings[0]
    alone = edit3r.build("segmenter", "grabcut").masks(photo, CLICK)
    assert torch.equal(found.logits, alone.logits)


@pytest.mark.slow
@pytest.mark.parametrize("size", ["sam2", "sam2-tiny"])
def test_with_weights_at_hand_clicks_and_tracks_are_sam2s_and_shown(
    at_hand, photo, size
):
    at_hand(size)
    events = []
    with collecting(Report(on_event=lambda *event: events.append(event[:2]))) as report:
        segmenter = edit3r.build("segmenter", "auto")
        found = segmenter.masks(photo, CLICK)
        mask = torch.zeros(1, 60, 80)
        mask[0, 10:50, 5:35] = 1
        tracks = segmenter.track(photo.expand(2, 3, 60, 80), mask)
    assert ("say", "segmenter: sam2") in events and not report.warnings
    assert report.notes["segmenter.weights"]["name"] == size
    alone = edit3r.build("segmenter", "sam2")
    assert torch.equal(found.logits, alone.masks(photo, CLICK).logits)
    expected = alone.track(photo.expand(2, 3, 60, 80), mask)
    assert torch.equal(tracks.logits, expected.logits)


def test_a_small_sam2_answers_where_its_weights_are(tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime")
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    for file, _ in SAM2_ONNX.files:
        place = tmp_path / SAM2_ONNX.name / SAM2_ONNX.stored(file)
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(b"")
    assert edit3r.build("segmenter", "auto").settings.pick == "sam2-onnx"


def test_words_need_the_weights_of_a_detector_too(at_hand, photo):
    at_hand("sam2")
    segmenter = edit3r.build("segmenter", "auto")
    assert segmenter.words(photo, "the bike") is None
    at_hand("grounding-dino-tiny")
    assert segmenter.words(photo, "the bike") is not None
    # a word that grabcut knows
    assert float(segmenter.words(photo, "everything")[0].soft_mask.min()) == 1


def test_the_pick_is_part_of_the_settings_and_can_be_made_by_hand(at_hand):
    at_hand("sam2")
    assert edit3r.build("segmenter", "auto").settings.pick == "sam2"
    by_hand = edit3r.build("segmenter", "auto", pick="grabcut", size=128)
    assert by_hand.picked.settings.size == 128


def test_it_is_what_a_run_takes_for_clicks():
    assert DEFAULTS["segmenter"] == "auto"


def test_what_is_remembered_of_grabcut_s_answers_depends_on_its_fetched_weights(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    grabcut = edit3r.build("segmenter", "auto").grabcut
    without = identity(grabcut)
    (tmp_path / "u2netp").mkdir()
    (tmp_path / "u2netp" / "u2netp.onnx").touch()
    assert identity(grabcut) != without
