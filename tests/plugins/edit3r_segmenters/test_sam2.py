"""SAM2 on a tiny random Hiera."""

import pytest
import torch
from edit3r_segmenters import sam
from edit3r_segmenters.sam import is_present

import edit3r
from edit3r.contract.errors import MissingDependencyError, RunError
from edit3r.contract.interfaces import SUBJECT, Detection, Detector
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.segmenting import mask_in_box
from edit3r.loading.registry import default_registry

pytestmark = pytest.mark.slow


class Boxes(Detector):
    """Stands in for a detector: always the same boxes [pixels]."""

    def __init__(self, *boxes):
        self.boxes, self.asked = boxes, []

    def detect(self, image, text):
        self.asked.append(text)
        return tuple(Detection(text, 0.9, box) for box in self.boxes)


def test_points_and_boxes_change_the_masks(build_sam2, photo):
    segmenter = build_sam2()
    by_point = segmenter.masks(photo, [((0.3, 0.5), True)]).logits
    others = [
        ([((0.9, 0.1), True)],),
        ([((0.3, 0.5), True), ((0.35, 0.5), True)],),
        ((), (0.1, 0.2, 0.4, 0.6)),
        ([((0.3, 0.5), True)], (0.1, 0.2, 0.4, 0.6)),
    ]
    for asked in others:
        assert not torch.equal(segmenter.masks(photo, *asked).logits, by_point)


def test_it_answers_marks_with_all_its_masks_as_a_small_sam_does(build_sam2, photo):
    segmenter = build_sam2()
    click = [((0.3, 0.5), True)]
    first = segmenter.masks(photo, click)
    assert len(first.logits) == len(first.quality) == 3
    best = int(first.quality.argmax())
    others = [
        segmenter.masks(photo, [((0.3, 0.5), False)]),
        segmenter.masks(photo, click, (0.1, 0.2, 0.4, 0.6)),
        segmenter.masks(photo, click, None, first.logits[best]),
    ]
    assert all((other.logits != first.logits).any() for other in others)


def test_words_become_masks_of_the_detectors_boxes(build_sam2, photo):
    detector = Boxes((8.0, 12.0, 32.0, 36.0), (40.0, 6.0, 20.0, 30.0))
    segmenter = build_sam2({"detector": detector})
    found = segmenter.words(photo, "the bike")
    assert detector.asked == ["the bike"] and len(found) == 2
    by_box = mask_in_box(segmenter, photo, (0.1, 0.2, 0.4, 0.6))
    assert torch.allclose(found[0].soft_mask, by_box, atol=1e-5)
    assert [one.confidence for one in found] == [0.9, 0.9]
    assert build_sam2({"detector": Boxes()}).words(photo, "the bike") == ()
    assert segmenter.words(photo, SUBJECT) is None  # no word for a detector


def test_the_real_detector_is_built_from_settings_and_feeds_the_segmenter(
    build_sam2, photo
):
    found = build_sam2().words(photo, "the bike")
    assert len(found) > 0 and all(one.soft_mask.shape == (60, 80) for one in found)


def test_tracks_start_from_the_given_masks_in_their_order(build_sam2, photo):
    masks = torch.zeros(2, 60, 80)
    masks[0, 10:50, 5:35] = 1
    masks[1, 5:25, 50:75] = 1
    tracks = build_sam2().track(photo.expand(3, 3, 60, 80), masks)
    assert tracks.logits.shape == (3, 2, 60, 80) and tracks.present.shape == (3, 2)
    inside = tracks.logits[0] > 0
    for number in (0, 1):
        both = (inside[number] & (masks[number] > 0)).sum() / (
            inside[number] | (masks[number] > 0)
        ).sum()
        assert both > 0.8
    assert tracks.present[0].all()
    lost = tracks.logits[~tracks.present]
    assert not (lost > 0).any()


def test_an_object_that_was_never_there_is_lost_in_view_0(build_sam2, photo):
    masks = torch.zeros(2, 60, 80)
    masks[1, 10:50, 5:35] = 1
    tracks = build_sam2().track(photo.expand(2, 3, 60, 80), masks)
    assert tracks.present[0].tolist() == [False, True]


def test_an_object_is_present_only_with_a_positive_score_or_a_mask():
    logits = torch.full((4, 2, 2), -1024.0)
    logits[1, 0, 0] = logits[3, 1, 1] = 3.0
    scores = torch.tensor([[-2.0], [-2.0], [1.0], [1.0]])
    assert is_present(logits, scores).tolist() == [False, True, True, True]


@pytest.mark.parametrize("kind", ["segmenter", "detector"])
@pytest.mark.parametrize("there", [(), ("large",), ("tiny",), ("tiny", "large")])
@pytest.mark.parametrize("gpu", [True, False])
def test_the_size_is_what_was_fetched_else_what_suits_the_device(
    at_hand, monkeypatch, kind, there, gpu
):
    name, large, tiny = {
        "segmenter": ("sam2", "sam2.1-hiera-large", "sam2.1-hiera-tiny"),
        "detector": ("grounding-dino", "grounding-dino-base", "grounding-dino-tiny"),
    }[kind]
    at_hand(*({"large": name, "tiny": f"{name}-tiny"}[size] for size in there))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: gpu)
    chosen = default_registry().load_class(default_registry().find(kind, name)).Settings
    takes_large = "large" in there or (gpu and not there)
    assert chosen().model.split("/")[1] == (large if takes_large else tiny)


def test_no_objects_give_no_tracks(build_sam2, photo):
    tracks = build_sam2().track(photo.expand(2, 3, 60, 80), torch.zeros(0, 60, 80))
    assert tracks.logits.shape == (2, 0, 60, 80) and tracks.present.shape == (2, 0)


def test_missing_weights_and_memory_are_sentences(build_sam2, photo, sam2_folder):
    click = [((0.5, 0.5), True)]
    with pytest.raises(MissingDependencyError, match=r"edit3r weights get sam2"):
        edit3r.build("segmenter", "sam2", local_files_only=True)
    segmenter = build_sam2()
    with collecting(Report()) as report:
        segmenter.masks(photo, click)
    assert report.notes["segmenter.weights"]["model"] == str(sam2_folder)

    def forward(*_, **__):
        raise torch.OutOfMemoryError("CUDA out of memory")

    segmenter._models["Sam2Model"].forward = forward
    with pytest.raises(RunError, match=r"out of memory while segmenting.*device=cpu"):
        segmenter.masks(photo, click)


def test_grey_becomes_imagenet_normalised_whatever_the_shape(build_sam2):
    pixels = build_sam2()._pixels(torch.full((2, 3, 30, 50), 0.5), 64)
    assert pixels.shape == (2, 3, 64, 64)
    assert torch.allclose(
        pixels[0, :, 0, 0],
        torch.tensor([0.015 / 0.229, 0.044 / 0.224, 0.094 / 0.225]),
        atol=1e-5,
    )


def test_masks_are_cut_at_a_half():
    soft = torch.tensor([[[0.2, 0.6], [0.5, 0.4]]])
    assert sam.binary_masks(soft, 2).tolist() == [[[0, 1], [1, 0]]]
