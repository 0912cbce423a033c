"""The style of a picture: one style for all photos, what a sentence means by it, and what is wrong
with files that do not fit. The networks are tiny random ones of the real form.
"""

from pathlib import Path

import numpy as np
import pytest
import torch
from skimage import data

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.photos.images import packaged_pair, save_pixels
from edit3r.running.editors import read
from edit3r_testing import CONTRACTS, Contract, claims, contract_for

PREDICT = """<ir_version: 8, opset_import: ["" : 15]>
predict (float[1,256,256,3] picture) => (float[1,1,1,100] vector)
<float[3,100] weights = {WEIGHTS}> {{
  mean = ReduceMean <axes = [1, 2], keepdims = 1> (picture)
  vector = MatMul (mean, weights)
}}"""
# Each pixel by itself, and a pattern of the places as the real one has: a checkerboard.
TRANSFORM = """<ir_version: 8, opset_import: ["" : 15]>
transform (float[1,384,384,3] photo, float[1,1,1,100] vector) => (float[1,384,384,3] drawn)
<float[3,3] colours = {COLOURS}, float[100,3] styles = {STYLES},
 float[1,384,384,1] places = {PLACES}> {{
  own = MatMul (photo, colours)
  style = MatMul (vector, styles)
  both = Add (own, style)
  there = Add (both, places)
  drawn = Sigmoid (there)
}}"""


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, str]:
    """The settings that name two networks and a picture."""
    parser = pytest.importorskip("onnx").parser
    folder, draw = tmp_path_factory.mktemp("style"), np.random.default_rng(0)
    board = np.indices((384, 384)).sum(0) % 2 - 0.5
    numbers = {
        "WEIGHTS": draw.normal(size=(3, 100)),
        "COLOURS": draw.normal(size=(3, 3)),
        "STYLES": draw.normal(size=(100, 3)) / 10,
        "PLACES": 2 * board,
    }
    texts = {
        name: "{" + ", ".join(f"{value:.6f}" for value in values.ravel()) + "}"
        for name, values in numbers.items()
    }
    for name, text in (("predict", PREDICT), ("transform", TRANSFORM)):
        model = parser.parse_model(text.format(**texts))
        (folder / f"{name}.onnx").write_bytes(model.SerializeToString())
    save_pixels(data.coffee(), folder / "picture.png", is_photo=False)
    save_pixels(data.coffee()[..., ::-1].copy(), folder / "other.png", is_photo=False)
    return {
        "predict": str(folder / "predict.onnx"),
        "transform": str(folder / "transform.onnx"),
        "picture": str(folder / "picture.png"),
    }


PHOTO = torch.from_numpy(data.astronaut()[:160, 100:300].astype(np.float32) / 255)
VIEWS = Views(
    torch.stack((PHOTO.permute(2, 0, 1), PHOTO.permute(2, 0, 1).roll(1, 2)))[None],
    torch.eye(3).expand(1, 2, 3, 3),
    ("a", "b"),
)


def edited(files, views=VIEWS, **settings) -> torch.Tensor:
    editor = edit3r.build("editor", "style", **(files | settings))
    return editor.edit(views, EditRequest("in the style of this picture")).images


@pytest.fixture(scope="module")
def contract(files):
    bound = contract_for("editor", "style", **files)
    bound.prompt = "make it in the style of this picture"
    return bound


@pytest.mark.slow
@pytest.mark.parametrize(
    "claim", sorted({*claims(CONTRACTS["editor"])} - {*claims(Contract)})
)
def test_style_keeps_the_contract_of_editors(contract, claim):
    getattr(contract(), claim)()


@pytest.mark.parametrize(
    ("prompt", "thing"),
    [
        ("in the style of this picture", ""),
        ("make it in the style of this painting", ""),
        ("like this picture", ""),
        ("make the wall like this picture", "wall"),
        ("paint the bike in the style of the picture", "bike"),
    ],
)
def test_a_sentence_that_means_a_picture_is_understood(files, prompt, thing):
    (instruction,) = read(prompt)
    without = {**files, "picture": ""}
    assert edit3r.build("editor", "style", **without).understands(instruction)
    assert (instruction.target.scope, instruction.target.name) == (
        ("named", thing) if thing else ("whole", instruction.target.name)
    )


@pytest.mark.parametrize("prompt", ["make it red", "remove the bike"])
def test_what_is_no_look_is_not_understood(files, prompt):
    (instruction,) = read(prompt)
    assert not edit3r.build("editor", "style", **files).understands(instruction)


def test_another_look_is_that_of_the_picture_where_one_is_given(files):
    (instruction,) = read("make it like a woodcut")
    editor = edit3r.build("editor", "style", **files)
    assert editor.understands(instruction)
    editor = edit3r.build("editor", "style", **{**files, "picture": ""})
    assert not editor.understands(instruction)


def test_a_picture_without_a_sentence_is_the_style_of_all(files):
    editor = edit3r.build("editor", "style", **files)
    asked = editor.instruction_of_nothing()
    assert editor.understands(asked) and asked.target.scope == "whole"


def test_without_a_picture_the_error_says_how_to_give_it(files):
    editor = edit3r.build("editor", "style", **{**files, "picture": ""})
    with pytest.raises(PromptError, match=r"--set editor\.picture=FILE"):
        editor.instruction_of_nothing()
    with pytest.raises(PromptError, match=r"--set editor\.picture=FILE"):
        edited(files, picture="")


def test_a_pattern_of_places_is_gone_and_comes_back_with_the_strokes(files):
    """Neighbours of one colour in the photo have one colour, whatever the network draws there."""
    flat = Views(torch.full((1, 2, 3, 96, 128), 0.4), torch.eye(3).expand(1, 2, 3, 3))
    alike = edited(files, flat)
    assert alike.std((-1, -2)).max() < 1e-3
    assert edited(files, flat, strokes=1.0).std((-1, -2)).max() > 0.05


def test_photos_that_show_the_same_get_the_same(files):
    first, second = edited(files)[0]
    middle = (slice(None), slice(24, -24), slice(24, -24))
    assert (first.roll(1, 2) - second)[middle].abs().max() < 1e-3
    assert (first - VIEWS.images[0, 0]).abs().mean() > 0.05


def test_another_picture_gives_another_style(files):
    other = str(Path(files["picture"]).with_name("other.png"))
    assert (edited(files) - edited(files, picture=other)).abs().mean() > 0.01


@pytest.mark.slow
def test_a_larger_photo_is_drawn_alike(files):
    larger = torch.nn.functional.interpolate(
        VIEWS.images[0], scale_factor=4, mode="bicubic"
    )
    views = Views(larger.clamp(0, 1)[None], VIEWS.intrinsics)
    small = torch.nn.functional.avg_pool2d(edited(files, views)[0], 4)
    assert (small - edited(files)[0]).abs().mean() < 0.02


def test_the_style_stays_in_the_region_of_its_instruction(files):
    regions = torch.zeros(1, 1, 2, *VIEWS.image_size)
    regions[..., :60] = 1
    request = EditRequest(
        "like this picture", 0, None, read("like this picture"), regions
    )
    images = edit3r.build("editor", "style", **files).edit(VIEWS, request).images
    assert torch.equal(images[..., 60:], VIEWS.images[..., 60:])
    assert (images[..., :60] - VIEWS.images[..., :60]).abs().mean() > 0.02


def test_strength_0_returns_the_photo(files):
    assert torch.equal(edited(files, strength=0.0), VIEWS.images)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"predict": ""}, "give both files"),
        ({"predict": "/nowhere.onnx"}, r"nowhere\.onnx: is not there"),
        ({"picture": "/nowhere.png"}, r"nowhere\.png: no such file"),
        ({"transform": __file__}, "onnxruntime cannot load it"),
    ],
)
def test_files_that_do_not_fit_are_named(files, change, message):
    with pytest.raises(InputError, match=message):
        edited(files, **change)


def test_networks_in_each_others_place_are_named(files):
    with pytest.raises(InputError, match="is none of the two networks"):
        edited(files, predict=files["transform"])


@pytest.mark.slow
def test_a_run_gives_the_packaged_pair_the_style(files, tmp_path):
    given = [f"--set=editor.{key}={value}" for key, value in files.items()]
    command = ["run", *packaged_pair()[0], "--editor", "style", "--size", "96", *given]
    out = tmp_path / "out"
    assert main([*command, "--prompt", "like this picture", "--out", str(out)]) == 0
    assert (out / "scene.ply").is_file()
