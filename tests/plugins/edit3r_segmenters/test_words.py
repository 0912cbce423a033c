"""Words, the small detectors that know them, and what an unsure or unknown word ends in."""

import json

import numpy as np
import pytest
import torch
from edit3r_segmenters import named, words
from edit3r_segmenters.coco import LEVELS, SIDE
from edit3r_segmenters.tfjs import TfjsGraph

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Detection, Detector
from edit3r_testing import CONTRACTS, Contract, claims, contract_for

IMAGE = torch.rand(3, 48, 96)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("the motorbike", {"motorcycle"}),
        ("bike", {"bicycle", "motorcycle"}),
        ("old red mugs", {"cup"}),
        ("sofa", {"couch"}),
        ("the little kitten", {"cat"}),
        ("lambs", {"sheep"}),
        ("girl", {"person"}),
        ("potted plants", {"potted plant"}),
        ("teapot", set()),
    ],
)
def test_a_word_or_its_synonym_is_one_of_coco(text, names):
    assert {words.COCO[place] for place in words.coco_classes(text)} == names


def test_every_synonym_means_something_to_the_detector():
    assert len(words.COCO) == 80
    assert [one for one in words.SYNONYMS if not words.coco_classes(one)] == []


def node(name, op, *inputs, **attributes):
    return {"name": name, "op": op, "input": list(inputs), "attr": attributes}


@pytest.fixture
def nanodet(tmp_path, monkeypatch):
    """A graph that answers with constants: one cup in the last level's first cell."""
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    folder = tmp_path / "nanodet"
    folder.mkdir()
    nodes, entries, numbers = [node("input_1", "Placeholder")], [], []
    for stride, (scores, distances) in zip((8, 16, 32), LEVELS):
        count = (SIDE // stride) ** 2
        score, distance = np.zeros((1, count, 80)), np.zeros((1, count, 44))
        if stride == 32:
            score[0, 0, words.COCO.index("cup")] = 0.6
            distance[0, 0, 1::11] = 50  # one stride to every side
        for name, values in ((scores, score), (distances, distance)):
            nodes += [node(name, "Identity", f"{name}/of"), node(f"{name}/of", "Const")]
            half = {"dtype": "float16"}
            shape = list(values.shape)
            entry = {"name": f"{name}/of", "shape": shape, "dtype": "float32"}
            entries.append({**entry, "quantization": half})
            numbers.append(values.astype(np.float16).tobytes())
    (folder / "nanodet.bin").write_bytes(b"".join(numbers))
    content = {
        "modelTopology": {"node": nodes},
        "weightsManifest": [{"weights": entries}],
    }
    (folder / "nanodet.json").write_text(json.dumps(content))
    return folder


def test_a_box_lies_where_the_network_says_in_pixels_of_the_photo(nanodet):
    found = edit3r.build("detector", "coco").detect(IMAGE, "the mug")
    # Seen squashed to the square, and in its own shape with a rim below.
    for one, seen_as in zip(found, ((96, 48), (96, 96)), strict=True):
        assert one.label == "cup" and one.score == pytest.approx(0.6, abs=1e-3)
        scale = np.array(seen_as * 2) / SIDE  # cell of 32, one stride to each side
        assert one.box == pytest.approx(
            tuple(np.array([0, 0, 48, 48]) * scale), abs=0.1
        )
    assert edit3r.build("detector", "coco").detect(IMAGE, "dog") == ()


DETECTOR_CLAIMS = sorted({*claims(CONTRACTS["detector"])} - {*claims(Contract)})


@pytest.mark.parametrize("claim", DETECTOR_CLAIMS)
def test_coco_keeps_the_contract(nanodet, claim):
    getattr(contract_for("detector", "coco")(), claim)()


@pytest.mark.parametrize(
    "harm",
    ["no json", "half the numbers", "NaN", "another operation", "another network"],
)
def test_a_damaged_network_is_one_sentence(nanodet, harm):
    json_file, bin_file = nanodet / "nanodet.json", nanodet / "nanodet.bin"
    if harm == "no json":
        json_file.write_text("{")
    elif harm == "half the numbers":
        bin_file.write_bytes(bin_file.read_bytes()[:1000])
    elif harm == "NaN":
        bin_file.write_bytes(b"\xff" * bin_file.stat().st_size)
    elif harm == "another operation":
        json_file.write_text(json_file.read_text().replace("Identity", "Softplus", 1))
        json_file.write_text(
            json_file.read_text().replace('"op": "Identity"', '"op": "Erf"')
        )
    else:
        json_file.write_text(json_file.read_text().replace("Identity_4", "Other"))
    with pytest.raises(
        InputError, match=r"nanodet\.json: (is no whole|asks for|does not)"
    ):
        edit3r.build("detector", "coco").detect(IMAGE, "mug")


def test_a_graph_computes_as_torch_does(tmp_path):
    kernel = np.random.default_rng(0).normal(size=(3, 3, 2, 4)).astype(np.float32)
    valid = {"s": "VkFMSUQ="}
    ones = {"list": {"i": ["1", "1", "1", "1"]}}
    nodes = [
        node("x", "Placeholder"),
        node("kernel", "Const"),
        node("order", "Const"),
        node("y", "Conv2D", "x", "kernel", padding=valid, strides=ones),
        node("z", "Transpose", "y", "order"),
        node("out", "LeakyRelu", "z", alpha={"f": 0.1}),
    ]
    order = np.array([0, 3, 1, 2], np.int32)
    entries = [
        {"name": "kernel", "shape": [3, 3, 2, 4], "dtype": "float32"},
        {"name": "order", "shape": [4], "dtype": "int32"},
    ]
    content = {
        "modelTopology": {"node": nodes},
        "weightsManifest": [{"weights": entries}],
    }
    (tmp_path / "a.json").write_text(json.dumps(content))
    (tmp_path / "a.bin").write_bytes(kernel.tobytes() + order.tobytes())
    x = torch.rand(1, 5, 6, 2)
    (found,) = TfjsGraph(tmp_path / "a.json").run({"x": x}, ["out"])
    weight = torch.from_numpy(kernel).permute(3, 2, 0, 1)
    expected = torch.nn.functional.conv2d(x.permute(0, 3, 1, 2), weight)
    assert torch.allclose(
        found, torch.nn.functional.leaky_relu(expected, 0.1), atol=1e-5
    )


class Boxes(Detector):
    """Finds three cups of which the last is a part of the first."""

    def detect(self, image, text):
        boxes = ((0, 8, 24, 32), (60, 8, 20, 32), (2, 10, 10, 10))
        scores = (0.7, 0.6, 0.5)
        return tuple(Detection("cup", *pair) for pair in zip(scores, boxes))


def test_things_of_one_name_are_found_without_parts_of_them(monkeypatch):
    # under its full name too, which is how detectors of others are asked
    monkeypatch.setattr(named, "usable", lambda name: name.endswith("coco"))
    monkeypatch.setattr(named, "build", lambda kind, name: Boxes())
    grabcut = edit3r.build("segmenter", "grabcut", learned=False)
    found = named.named(IMAGE, "cups", grabcut)
    assert len(found) == 2 and found[0].confidence > found[1].confidence > 0.5
    assert named.named(IMAGE, "mosaic", grabcut) is None


def test_a_detector_of_any_word_is_asked_first_where_it_is_at_hand(monkeypatch):
    monkeypatch.setattr(named, "usable", lambda name: True)
    asked = []
    monkeypatch.setattr(
        named, "build", lambda kind, name: asked.append(name) or Boxes()
    )
    grabcut = edit3r.build("segmenter", "grabcut", learned=False)
    found = named.named(IMAGE, "mosaic", grabcut)
    assert asked == ["grounding-dino"]
    assert [one.confidence for one in found] == [0.7, 0.6]  # its own scores


def test_an_unknown_word_names_the_weights_that_are_missing(tmp_path, monkeypatch):
    from edit3r_select.by_segmenter import select_masks

    from edit3r.contract.interfaces import Selection

    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    segmenter = edit3r.build("segmenter", "auto")
    with pytest.warns(UserWarning, match=r"--point.*weights get essentials"):
        select_masks(IMAGE[None], Selection(words="mug"), segmenter)


def test_the_picture_is_a_thing_and_the_whole_picture_is_the_photo():
    segmenter = edit3r.build("segmenter", "grabcut", learned=False)
    assert segmenter.words(IMAGE, "the picture") is None
    (whole,) = segmenter.words(IMAGE, "the whole picture")
    assert (whole.soft_mask == 1).all()
    (photo,) = segmenter.words(IMAGE, "the photo")
    assert (photo.soft_mask == 1).all()
