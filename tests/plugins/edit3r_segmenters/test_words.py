"""Words, the small detectors that know them, and what an unsure or unknown word ends in."""

import json

import numpy as np
import pytest
import torch
from edit3r_segmenters import named, words
from edit3r_segmenters.coco import LEVELS, SIDE
from edit3r_segmenters.tfjs import TfjsGraph

import edit3r
from edit3r.contract.errors import InputError, MissingDependencyError
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
        ("potted plants", {"potted plant"}),
        ("teapot", set()),
    ],
)
def test_a_word_or_its_synonym_is_one_of_coco(text, names):
    assert {words.COCO[place] for place in words.coco_classes(text)} == names


@pytest.mark.parametrize(
    ("text", "name"),
    [("duvet", "quilt"), ("foxes", "red fox"), ("bear", "ice bear"), ("dog", "kuvasz")],
)
def test_a_word_is_one_of_imagenet(text, name):
    found = [words.imagenet_names()[place] for place in words.imagenet_classes(text)]
    assert any(name in line.split(", ") for line in found)
    assert words.imagenet_classes("mosaic") == ()


def test_every_synonym_means_something_to_a_detector():
    unknown = [
        word
        for word in words.SYNONYMS
        if not (words.coco_classes(word) or words.imagenet_classes(word))
    ]
    assert len(words.COCO) == 80 and len(words.imagenet_names()) == 1000
    assert unknown == []


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


@pytest.fixture
def efficientnet(tmp_path, monkeypatch):
    """Random weights of the network, where they are looked for."""
    network = pytest.importorskip("efficientnet_lite_pytorch").EfficientNet
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    file = tmp_path / "efficientnet-lite0" / "efficientnet-lite0-57934424.pth"
    file.parent.mkdir()
    torch.save(network.from_name("efficientnet-lite0").state_dict(), file)


DETECTOR_CLAIMS = sorted({*claims(CONTRACTS["detector"])} - {*claims(Contract)})


@pytest.mark.parametrize("claim", DETECTOR_CLAIMS)
def test_coco_keeps_the_contract(nanodet, claim):
    getattr(contract_for("detector", "coco")(), claim)()


@pytest.mark.parametrize("claim", DETECTOR_CLAIMS)
def test_imagenet_keeps_the_contract(efficientnet, claim):
    getattr(contract_for("detector", "imagenet", size=64)(), claim)()


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


def test_the_activation_of_a_word_peaks_at_one(tmp_path, monkeypatch):
    network = pytest.importorskip("efficientnet_lite_pytorch").EfficientNet
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    with pytest.raises(MissingDependencyError, match="weights get efficientnet-lite0"):
        edit3r.build("detector", "imagenet")
    (tmp_path / "efficientnet-lite0").mkdir()
    file = tmp_path / "efficientnet-lite0" / "efficientnet-lite0-57934424.pth"
    torch.manual_seed(0)
    state = network.from_name("efficientnet-lite0").state_dict()
    torch.save(state, file)
    detector = edit3r.build("detector", "imagenet", size=64)
    name, probability, heat = detector.activation(IMAGE, "the fox")
    assert "fox" in name and 0 <= probability < 1 and heat.shape == (48, 96)
    assert heat.max() <= 1 and heat.min() >= 0
    assert detector.activation(IMAGE, "mosaic") is None
    blind = {
        name: 0 * value if "_fc" in name else value for name, value in state.items()
    }
    torch.save(blind, file)  # all classes alike: 118 of 1,000 say nothing of a dog
    guess = edit3r.build("detector", "imagenet", size=64).activation(IMAGE, "dog")
    assert guess[1] == pytest.approx(0, abs=1e-6)
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(InputError, match="holds no EfficientNet-lite0"):
        edit3r.build("detector", "imagenet").detect(IMAGE, "fox")


class Boxes(Detector):
    """Finds three cups of which the last is a part of the first."""

    def detect(self, image, text):
        boxes = ((0, 8, 24, 32), (60, 8, 20, 32), (2, 10, 10, 10))
        scores = (0.7, 0.6, 0.5)
        return tuple(Detection("cup", *pair) for pair in zip(scores, boxes))


def test_things_of_one_name_are_found_without_parts_of_them(monkeypatch):
    monkeypatch.setattr(named, "usable", lambda name: name == "coco")
    monkeypatch.setattr(named, "build", lambda kind, name: Boxes())
    classical = edit3r.build("segmenter", "classical", learned=False)
    found = named.Namer(classical.segment_marks).find(IMAGE, "cups")
    assert len(found) == 2 and found[0].confidence > found[1].confidence > 0.5
    assert named.Namer(classical.segment_marks).find(IMAGE, "mosaic") is None


class Classifier:
    """Two places are lit up; alone, what is bright looks alike."""

    def activation(self, image, text):
        heat = np.zeros(image.shape[-2:], np.float32)
        heat[20, 20], heat[24, 74] = 1.0, 0.8
        return text, 0.1, heat

    def likeness(self, pictures, text):
        return torch.tensor([10 * float(picture[0].mean()) for picture in pictures])


@pytest.mark.parametrize("bright, column", [(True, 74), (False, 20)])
def test_of_places_that_a_word_lights_up_that_counts_which_looks_like_it(
    bright, column, monkeypatch
):
    monkeypatch.setattr(named, "usable", lambda detector: detector == "imagenet")
    monkeypatch.setattr(named, "build", lambda kind, name: Classifier())
    image = torch.zeros(3, 48, 96)
    image[:, :, 48:] = float(bright)

    def ask(image, clicks):
        ((x, y), _), *_ = clicks
        logits = -np.ones((1, 48, 96), np.float32)
        row, column = int(y * 48), int(x * 96)
        logits[0, row - 4 : row + 4, column - 4 : column + 4] = 1
        return logits, np.ones(1, np.float32)

    found = named.Namer(None, ask).find(image, "fox")
    assert found[0].soft_mask[24 if bright else 20, column] > 0.5


def test_an_unknown_word_names_the_weights_that_are_missing(tmp_path, monkeypatch):
    from edit3r_select.select import select_masks

    from edit3r.contract.interfaces import Selection

    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    segmenter = edit3r.build("segmenter", "auto")
    with pytest.raises(InputError, match=r"--point.*weights get essentials"):
        select_masks(IMAGE[None], Selection(words="mug"), segmenter)


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("puppy", "dog"),
        ("the little kitten", "cat"),
        ("armchair", "chair"),
        ("lambs", "sheep"),
        ("girl", "person"),
        ("rooster", "bird"),
    ],
)
def test_everyday_words_mean_the_class_that_fits(said, meant):
    assert {*words.coco_classes(meant)} <= {*words.coco_classes(said)} != set()


def test_the_picture_is_a_thing_and_the_whole_picture_is_the_photo():
    segmenter = edit3r.build("segmenter", "classical", learned=False)
    assert segmenter.segment_text(IMAGE, "the picture") is None
    (whole,) = segmenter.segment_text(IMAGE, "the whole picture")
    assert (whole.soft_mask == 1).all()
    (photo,) = segmenter.segment_text(IMAGE, "the photo")
    assert (photo.soft_mask == 1).all()
