"""SAM3 on tiny random weights in the layout of the hub's file: words without a detector, clicks,
tracks, refusals.
"""

import shutil

import pytest
import torch
from safetensors.torch import load_file, save_file

import edit3r
from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.reporting import Report, collecting


def test_words_become_masks_of_the_photo_size_best_first(build_sam3, photo):
    found = build_sam3().words(photo, "the bike")
    scores = [proposal.confidence for proposal in found]
    assert 0 < len(found) <= 8 and scores == sorted(scores, reverse=True)
    assert all(p.soft_mask.shape == (60, 80) and p.area > 0 for p in found)


def test_other_words_score_differently_and_the_article_says_nothing(build_sam3, photo):
    segmenter = build_sam3()
    bike, the_bike, door = (
        segmenter.words(photo, text) for text in ("bike", "the bike", "door")
    )
    assert [p.confidence for p in bike] == [p.confidence for p in the_bike]
    assert [p.confidence for p in bike] != [p.confidence for p in door]


def test_what_scores_below_the_bound_is_not_there(build_sam3, photo):
    scores = [proposal.confidence for proposal in build_sam3().words(photo, "bike")]
    bound = (scores[0] + scores[1]) / 2
    assert [
        p.confidence for p in build_sam3(min_score=bound).words(photo, "bike")
    ] == scores[:1]
    assert build_sam3(min_score=1.0).words(photo, "bike") == ()


def test_its_words_network_is_the_one_that_the_file_holds(
    build_sam3, sam3_folder, photo
):
    """Loaded through the same code as the real file, against transformers' own result for the same
    inputs.
    """
    from transformers import Sam3Model

    segmenter = build_sam3()
    found = segmenter.words(photo, "bike")
    network = Sam3Model.from_pretrained(sam3_folder).eval()
    tokens = segmenter._tokenizer(
        "bike", return_tensors="pt", padding="max_length", max_length=32
    )
    with torch.no_grad():
        own = network(pixel_values=segmenter._pixels(photo[None], 112), **tokens)
    score = (own.pred_logits.sigmoid() * own.presence_logits.sigmoid()).max()
    assert found[0].confidence == pytest.approx(float(score), abs=1e-5)


def test_a_click_and_a_box_give_different_masks_and_tracks_start_from_theirs(
    build_sam3, photo
):
    segmenter = build_sam3()
    click = segmenter.masks(photo, [((0.3, 0.5), True)])
    box = segmenter.masks(photo, (), (0.1, 0.2, 0.4, 0.6))
    assert not torch.equal(click.logits, box.logits)
    masks = torch.zeros(1, 60, 80)
    masks[0, 10:50, 5:35] = 1
    tracks = segmenter.track(photo.expand(3, 3, 60, 80), masks)
    inside = tracks.logits[0, 0] > 0
    assert (inside & (masks[0] > 0)).sum() / (inside | (masks[0] > 0)).sum() > 0.8


def test_images_are_normalised_to_minus_one_to_one(build_sam3):
    pixels = build_sam3()._pixels(
        torch.tensor([0.25, 0.5, 1.0])[None, :, None, None].expand(1, 3, 20, 30), 14
    )
    assert pixels[0, :, 7, 7].tolist() == pytest.approx([-0.5, 0, 1], abs=1e-5)


def test_gated_weights_are_told_before_any_work(monkeypatch, tmp_path):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    with pytest.raises(
        MissingDependencyError,
        match=r"edit3r weights get sam3 \(SAM License.*gated: needs an account",
    ):
        edit3r.build("segmenter", "sam3")


def test_a_file_that_lacks_weights_is_refused(build_sam3, sam3_folder, photo, tmp_path):
    folder = tmp_path / "changed"
    shutil.copytree(sam3_folder, folder)
    state = load_file(folder / "model.safetensors")
    state["tracker_model.prompt_decoder"] = state.pop(
        "tracker_model.no_memory_embedding"
    )
    save_file(state, folder / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(
        InputError,
        match="lacks 1 weights of Sam3TrackerModel, such as no_memory_embedding",
    ):
        build_sam3(model=str(folder)).masks(photo, [((0.3, 0.5), True)])


def test_the_weights_that_were_used_are_noted(build_sam3, photo, sam3_folder):
    with collecting(Report()) as report:
        build_sam3().masks(photo, [((0.3, 0.5), True)])
    assert report.notes["segmenter.weights"]["model"] == str(sam3_folder)
