"""SAM2 on a tiny random Hiera, and the fields of its masks by closed forms."""

import math

import pytest
import torch
from edit3r_segmenters import sam
from edit3r_segmenters.sam import is_present

import edit3r
from edit3r.contract.errors import (
    InputError,
    MissingDependencyError,
    PromptError,
    RunError,
)
from edit3r.contract.interfaces import Detection, Detector
from edit3r.contract.reporting import Report, collecting
from edit3r.loading.registry import default_registry

pytestmark = pytest.mark.slow


class Boxes(Detector):
    """Stands in for a detector: always the same boxes [pixels]."""

    def __init__(self, *boxes):
        self.boxes, self.asked = boxes, []

    def detect(self, image, text):
        self.asked.append(text)
        return tuple(Detection(text, 0.9, box) for box in self.boxes)


def test_proposals_have_consistent_fields_best_first(build_sam2, photo):
    proposals = build_sam2().propose(photo)
    assert proposals
    ious = [proposal.predicted_iou for proposal in proposals]
    assert ious == sorted(ious, reverse=True)
    for proposal in proposals:
        inside = proposal.soft_mask > 0.5
        assert (
            proposal.soft_mask.shape == (60, 80)
            and 0 <= proposal.soft_mask.min() <= proposal.soft_mask.max() <= 1
        )
        assert (
            proposal.area == pytest.approx(inside.float().mean().item())
            and proposal.area > 0
        )
        assert 0 <= proposal.stability <= 1
        rows, columns = torch.nonzero(inside, as_tuple=True)
        x, y, width, height = proposal.box
        assert (x, y) == (columns.min(), rows.min())
        assert (x + width, y + height) == (columns.max() + 1, rows.max() + 1)


def test_equal_pictures_give_equal_proposals_whatever_the_batch(build_sam2, photo):
    first, second = (
        build_sam2().propose(photo),
        build_sam2(points_per_batch=3).propose(photo),
    )
    assert len(first) == len(second)
    for one, other in zip(first, second):
        assert torch.allclose(one.soft_mask, other.soft_mask, atol=1e-4)


def test_quality_bounds_and_overlap_only_ever_remove_proposals(build_sam2, photo):
    everything = build_sam2(max_box_overlap=1.0).propose(photo)
    half_iou = sorted(proposal.predicted_iou for proposal in everything)[
        len(everything) // 2
    ]
    sure = build_sam2(max_box_overlap=1.0, min_predicted_iou=half_iou - 1e-6).propose(
        photo
    )
    assert 0 < len(sure) < len(everything) and all(
        p.predicted_iou >= half_iou - 1e-5 for p in sure
    )
    half_stable = sorted(proposal.stability for proposal in everything)[
        len(everything) // 2
    ]
    stable = build_sam2(max_box_overlap=1.0, min_stability=half_stable).propose(photo)
    assert 0 < len(stable) < len(everything) and all(
        p.stability >= half_stable - 1e-5 for p in stable
    )
    assert len(build_sam2(max_box_overlap=0.3).propose(photo)) < len(everything)


def test_points_and_boxes_change_the_mask(build_sam2, photo):
    segmenter = build_sam2()
    by_point = segmenter.segment(photo, points=[(0.3, 0.5)])
    others = [
        segmenter.segment(photo, points=[(0.9, 0.1)]),
        segmenter.segment(photo, points=[(0.3, 0.5), (0.35, 0.5)]),
        segmenter.segment(photo, box=(0.1, 0.2, 0.4, 0.6)),
        segmenter.segment(photo, points=[(0.3, 0.5)], box=(0.1, 0.2, 0.4, 0.6)),
    ]
    for other in others:
        assert other.soft_mask.shape == (60, 80) and not torch.equal(
            other.soft_mask, by_point.soft_mask
        )


def test_it_answers_marks_with_all_its_masks_as_a_small_sam_does(build_sam2, photo):
    segmenter = build_sam2()
    click = [((0.3, 0.5), True)]
    logits, quality = segmenter.ask(photo, click)
    assert logits.shape[0] == quality.shape[0] == 3
    best = int(quality.argmax())
    single = segmenter.segment(photo, points=[(0.3, 0.5)])
    assert single.predicted_iou == pytest.approx(min(max(quality[best], 0), 1))
    others = [
        segmenter.ask(photo, [((0.3, 0.5), False)]),
        segmenter.ask(photo, click, box=(0.1, 0.2, 0.4, 0.6)),
        segmenter.ask(photo, click, before=logits[best]),
    ]
    assert all((other != logits).any() for other, _ in others)


def test_a_segment_of_nothing_is_refused(build_sam2, photo):
    with pytest.raises(InputError, match="at least one point, or a box"):
        build_sam2().segment(photo)


def test_words_become_masks_of_the_detectors_boxes(build_sam2, photo):
    detector = Boxes((8.0, 12.0, 32.0, 36.0), (40.0, 6.0, 20.0, 30.0))
    segmenter = build_sam2({"detector": detector})
    found = segmenter.segment_text(photo, "the bike")
    assert detector.asked == ["the bike"] and len(found) == 2
    by_box = segmenter.segment(photo, box=(0.1, 0.2, 0.4, 0.6))
    assert torch.allclose(found[0].soft_mask, by_box.soft_mask, atol=1e-5)
    assert build_sam2({"detector": Boxes()}).segment_text(photo, "the bike") == ()


def test_the_prompt_setting_limits_proposals_to_what_it_names(build_sam2, photo):
    detector = Boxes((8.0, 12.0, 32.0, 36.0))
    (only,) = build_sam2({"detector": detector}, prompt="the bike").propose(photo)
    assert detector.asked == ["the bike"] and only.soft_mask.shape == (60, 80)
    with pytest.raises(PromptError, match=r"'the bike' was not found.*box_threshold"):
        build_sam2({"detector": Boxes()}, prompt="the bike").propose(photo)


def test_the_real_detector_is_built_from_settings_and_feeds_the_segmenter(
    build_sam2, photo
):
    found = build_sam2(prompt="the bike").propose(photo)
    assert len(found) > 0 and all(
        proposal.soft_mask.shape == (60, 80) for proposal in found
    )


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


def test_progress_and_weights_are_reported(build_sam2, photo, sam2_folder):
    events = []
    report = Report(on_event=lambda *event: events.append(event))
    with collecting(report):
        build_sam2(points_per_batch=8).propose(photo)
    assert ("progress", "segmenting", 8, 16) in events and (
        "progress",
        "segmenting",
        16,
        16,
    ) in events
    assert report.notes["segmenter.weights"]["model"] == str(sam2_folder)


def test_missing_weights_and_memory_are_sentences(build_sam2, photo):
    with pytest.raises(MissingDependencyError, match=r"edit3r weights get sam2"):
        edit3r.build("segmenter", "sam2", local_files_only=True).propose(photo)
    segmenter = build_sam2()
    segmenter.propose(photo)

    def forward(*_, **__):
        raise torch.OutOfMemoryError("CUDA out of memory")

    segmenter._models["Sam2Model"].forward = forward
    with pytest.raises(
        RunError, match=r"out of memory while segmenting.*points_per_batch"
    ):
        segmenter.propose(photo)


def cone(radius: float, slope: float = 1.0, size: int = 101) -> torch.Tensor:
    """Logits that fall by `slope` a pixel from the centre and are 0 at `radius`."""
    y, x = torch.meshgrid(
        torch.arange(size) - size // 2, torch.arange(size) - size // 2, indexing="ij"
    )
    return (radius - torch.hypot(x.float(), y.float())) * slope


def test_stability_of_a_cone_is_the_ratio_of_two_discs():
    logits = torch.stack((cone(20.0), cone(40.0), cone(20.0, slope=0.1)))
    expected = torch.tensor([(19 / 21) ** 2, (39 / 41) ** 2, (10 / 30) ** 2])
    assert torch.allclose(sam.stability(logits), expected, atol=0.03)


def test_a_sharp_mask_is_fully_stable_and_an_empty_one_not_at_all():
    sharp = torch.where(cone(20.0) > 0, 8.0, -8.0)
    assert sam.stability(torch.stack((sharp, torch.full_like(sharp, -8)))).tolist() == [
        1.0,
        0.0,
    ]


def test_boxes_are_x_y_width_height_in_pixels():
    inside = torch.zeros(3, 10, 20, dtype=torch.bool)
    inside[0, 2:5, 7:15] = True
    inside[1, 9, 19] = True
    assert sam.boxes_of(inside).tolist() == [[7, 2, 8, 3], [19, 9, 1, 1], [0, 0, 0, 0]]


def test_a_proposal_carries_the_sigmoid_of_the_logits_and_the_area_above_a_half():
    logits = cone(20.0)
    proposal = sam.proposal(logits, 0.9)
    assert torch.equal(proposal.soft_mask, torch.sigmoid(logits))
    assert proposal.soft_mask[50, 50] == torch.sigmoid(torch.tensor(20.0))
    assert proposal.area == pytest.approx(
        (proposal.soft_mask > 0.5).float().mean().item()
    )
    assert proposal.area == pytest.approx(math.pi * 400 / 101**2, rel=0.02)
    assert proposal.predicted_iou == pytest.approx(0.9)
    assert proposal.box == (31.0, 31.0, 39.0, 39.0)


def test_of_boxes_that_overlap_more_than_allowed_the_best_stays():
    boxes = torch.tensor(
        [[0, 0, 10, 10], [1, 0, 10, 10], [30, 30, 5, 5], [0, 0, 10, 6.0]]
    )
    scores = torch.tensor([0.8, 0.9, 0.5, 0.7])
    # IoU of the first two is 9/11, of the first and last 0.6, of the second and last 54/106.
    assert sam.best_boxes(boxes, scores, 0.7) == [1, 3, 2]
    assert sam.best_boxes(boxes, scores, 0.5) == [1, 2]
    assert sam.best_boxes(boxes, scores, 0.9) == [1, 0, 3, 2]
    assert sam.best_boxes(boxes[:0], scores[:0], 0.7) == []


def test_predicted_iou_outside_its_range_is_brought_into_it():
    assert [sam.proposal(cone(9.0), iou).predicted_iou for iou in (1.2, -0.1)] == [1, 0]


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


def test_enlarging_keeps_the_order_of_masks_and_constants():
    logits = torch.arange(6.0).view(2, 3, 1, 1).expand(2, 3, 4, 4)
    large = sam.enlarge(logits, (7, 9))
    assert large.shape == (2, 3, 7, 9)
    assert torch.equal(large[..., 0, 0], torch.arange(6.0).view(2, 3))
