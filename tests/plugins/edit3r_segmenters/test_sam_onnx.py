"""Segmenter `sam-onnx` on a tiny network that answers with discs around the first click."""

import time
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.kit import cache
from edit3r.kit.segmenting import boxes_of, enlarged

pytest.importorskip("onnxruntime")
CLICK = [((0.75, 0.5), True)]


def best_box(answer):
    """x, y, width and height on a photo of 80 x 60 pixels of the best mask."""
    best = int(answer.quality.argmax())
    large = enlarged(answer.logits[best : best + 1], (60, 80))
    return boxes_of(large > 0)[0].tolist()


def test_a_click_is_answered_by_the_mask_that_the_network_believes_in_most(
    build_sam_onnx, photo
):
    found = build_sam_onnx().masks(photo, CLICK)
    assert float(found.quality.max()) == pytest.approx(0.9)
    # The disc of 3 of 16 cells; a cell is 5 pixels wide and 3.75 high.
    x, y, width, height = best_box(found)
    assert (x + width / 2, y + height / 2) == pytest.approx((60, 30), abs=1.5)
    assert (width, height) == pytest.approx((30, 22.5), abs=2)


def test_the_answer_before_is_told_in_the_network_s_own_frame(build_sam_onnx, photo):
    class Decoder:
        def get_inputs(self):
            names = ("mask_input", "has_mask_input")
            return [SimpleNamespace(name=name) for name in names]

        def run(self, outputs, feeds):
            told.append(feeds)
            return np.zeros((1, 3, 16, 16), np.float32), np.ones((1, 3), np.float32)

    told, segmenter = [], build_sam_onnx()
    segmenter._decoder = Decoder()
    before = torch.full((30, 40), 4.0)  # all of a photo of 60 x 80 pixels
    segmenter.masks(photo, [((0.5, 0.5), True)])
    segmenter.masks(photo, [((0.5, 0.5), True)], None, before)
    assert [float(one["has_mask_input"][0]) for one in told] == [0, 1]
    assert (told[1]["mask_input"] == 4).all()
    segmenter.masks(photo.clone(), [((0.5, 0.5), True)])  # known by what it shows
    assert len(told) == 2
    segmenter.masks(1 - photo, [((0.5, 0.5), True)])
    assert len(told) == 3


def test_an_image_is_read_once_and_the_run_s_cache_keeps_it(build_sam_onnx, photo):
    kept = cache.Cache()
    with cache.using(kept):
        build_sam_onnx().masks(photo, CLICK)
        build_sam_onnx().masks(photo, [((0.2, 0.5), True)])
    assert kept.computed == ["embed"] and kept.reused == ["embed"]


@pytest.mark.parametrize("which", ["encoder", "decoder"])
@pytest.mark.parametrize("content", [None, b"", b"not a network", "half"])
def test_a_missing_or_damaged_file_is_told(
    build_sam_onnx, sam_onnx_folder, photo, tmp_path, which, content
):
    name = {"encoder": "encoder.onnx", "decoder": "sam.onnx"}[which]
    file = tmp_path / name
    if content == "half":
        content = (sam_onnx_folder / name).read_bytes()[:100]
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=f"{name}: (is not there|onnxruntime cannot)"):
        build_sam_onnx(**{which: str(file)}).masks(photo, CLICK)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("OUTPUTS", ("no_such_value", "quality"), "sam.onnx: onnxruntime cannot load"),
        ("OUTPUTS", ("logits", "distance"), r"expected \[1, n, h, w\] and \[1, n\]"),
        ("SIDE", 128, "encoder.onnx: does not take what a SAM 2 takes"),
    ],
)
def test_a_file_of_another_layout_is_told(
    build_sam_onnx, photo, monkeypatch, name, value, told
):
    monkeypatch.setattr(f"edit3r_segmenters.sam_onnx.{name}", value)
    with pytest.raises(InputError, match=told):
        build_sam_onnx().masks(photo, CLICK)


def test_a_decoder_that_asks_for_other_things_is_told(
    build_sam_onnx, sam_onnx_folder, photo, monkeypatch
):
    monkeypatch.setattr("edit3r_segmenters.sam_onnx.OUTPUTS", ("image_embed",) * 2)
    encoder = str(sam_onnx_folder / "encoder.onnx")
    with pytest.raises(InputError, match="asks for image; expected a SAM 2's decoder"):
        build_sam_onnx(decoder=encoder).masks(photo, CLICK)


def test_without_weights_the_command_that_fetches_them_is_told(
    build_sam_onnx, tmp_path, monkeypatch
):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    with pytest.raises(MissingDependencyError, match="edit3r weights get sam2-onnx"):
        build_sam_onnx(encoder="", decoder="")
    with pytest.raises(InputError, match="both files"):
        build_sam_onnx(encoder="")


def test_two_who_ask_at_once_have_a_photo_read_once(build_sam_onnx, photo, monkeypatch):
    segmenter, read = build_sam_onnx(), []
    encode = segmenter._encode

    def slowly(image):
        read.append(image)
        time.sleep(0.2)
        return encode(image)

    monkeypatch.setattr(segmenter, "_encode", slowly)
    asks = [Thread(target=segmenter.masks, args=(photo, CLICK)) for _ in range(2)]
    for one in asks:
        one.start()
    for one in asks:
        one.join()
    assert len(read) == 1
