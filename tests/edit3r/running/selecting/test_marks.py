"""--point, --box and --mask, read into a selection."""

import argparse
import json

import pytest
import torch
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.kit.photos.images import load_photos
from edit3r.running.flags import add_mark_flags
from edit3r.running.selecting.marks import MarkTexts


@pytest.fixture
def photos(tmp_path):
    for name in ("left", "right"):
        Image.new("RGB", (80, 60), (90, 120, 40)).save(tmp_path / f"{name}.png")
    return load_photos([tmp_path / "left.png", tmp_path / "right.png"])


def read(photos, *words):
    parser = argparse.ArgumentParser()
    add_mark_flags(parser)
    args = parser.parse_args(words)
    texts = MarkTexts(
        args.point,
        args.not_point,
        args.box,
        args.mask,
        strokes=tuple(args.stroke),
        regions=tuple(args.region),
    )
    return texts.read(photos) if texts.given else None


def test_no_flag_marks_nothing(photos):
    assert read(photos) is None


def test_pixels_and_shares_mean_the_same_place(photos):
    expected = ((0, 0.25, 0.5),)
    assert read(photos, "--point", "20,30").positive == expected
    assert read(photos, "--point", "0.25,0.5").positive == expected


def test_a_number_names_the_photo(photos):
    marked = read(
        photos, "--point", "2:20,30", "--not-point", "8,6", "--box", "2:8,12,40,15"
    )
    assert marked.positive == ((1, 0.25, 0.5),) and marked.negative == ((0, 0.1, 0.1),)
    assert marked.boxes[1] == pytest.approx((0.1, 0.2, 0.5, 0.25))


def test_a_stroke_is_a_line_of_places(photos):
    marked = read(photos, "--stroke", "2:20,30,40,30,60,15")
    assert marked.strokes == ((1, ((0.25, 0.5), (0.5, 0.5), (0.75, 0.25))),)
    assert marked.views == (1,) and marked.says_where
    for wrong in ("20", "20,30", "20,30,40", "0.1,0.1,90,90", "a,b,c,d"):
        with pytest.raises(InputError, match="--stroke"):
            read(photos, "--stroke", wrong)


def test_a_region_is_a_box_of_its_own_kind(photos):
    marked = read(photos, "--region", "2:8,12,40,15")
    ((view, box),) = marked.regions
    assert view == 1 and box == pytest.approx((0.1, 0.2, 0.5, 0.25))
    assert not marked.boxes and marked.says_where and marked.views == (1,)
    with pytest.raises(InputError, match="--region"):
        read(photos, "--region", "1,2,3")


def test_one_mask_belongs_to_the_photo_in_its_name_else_to_the_first(photos, tmp_path):
    for name in ("right_mask", "thing"):
        Image.new("L", (80, 60), 255).save(tmp_path / f"{name}.png")
    assert list(read(photos, "--mask", str(tmp_path / "right_mask.png")).masks) == [1]
    marked = read(photos, "--mask", str(tmp_path / "thing.png"))
    assert list(marked.masks) == [0] and torch.equal(
        marked.masks[0], torch.ones(60, 80)
    )


@pytest.mark.parametrize(
    "words",
    [("--point", "20"), ("--point", "3:2,2"), ("--point", "x,y"), ("--box", "1,2,3")],
)
def test_what_cannot_be_read_says_what_was_expected(photos, words):
    with pytest.raises(InputError, match=r"expected X,Y.*pixels of the original photo"):
        read(photos, *words)


@pytest.mark.parametrize(
    "words",
    [("--point", "200,30"), ("--box", "100,30,9,9"), ("--box=-15,30,9,9",)],
)
def test_a_place_outside_the_photo_is_an_error_that_says_its_size(photos, words):
    with pytest.raises(
        InputError, match=r"outside.* y from 0 to 60 of its 80 x 60 pix"
    ):
        read(photos, *words)


@pytest.mark.parametrize("words", [("--point", "nan,3"), ("--box", "1,2,inf,4")])
def test_places_are_finite_numbers(photos, words):
    with pytest.raises(InputError, match="finite"):
        read(photos, *words)


def test_words_are_no_book(photos):
    with pytest.raises(InputError, match="at most 10000 characters, got 500000"):
        MarkTexts(thing="bike " * 100_000).read(photos)


def test_a_box_is_cut_to_the_photo(photos):
    for box, cut in {
        "40,15,99,99": (0.5, 0.25, 0.5, 0.75),
        "-9,-9,29,54": (0, 0, 0.25, 0.75),
    }.items():
        assert read(photos, f"--box={box}").boxes[0] == pytest.approx(cut)


def test_a_box_holds_a_pixel_at_least(photos):
    assert read(photos, "--box", "20,30,1,1").boxes[0][2:] == pytest.approx(
        (1 / 80, 1 / 60)
    )
    for size in ("0.9,9", "9,0.9"):
        with pytest.raises(InputError, match=r"contains no pixel of photo 2 .*80 x 60"):
            read(photos, "--box", f"2:20,30,{size}")
    with pytest.raises(InputError, match="at least 0"):
        read(photos, "--box", "20,30,9,-9")


@pytest.mark.filterwarnings("ignore:.*cropped")
def test_marks_are_on_what_is_used_of_their_own_photo(tmp_path):
    """Of 80 x 60 and 100 x 60 pixels the middle 80 x 54 and 88.9 x 60 are used."""
    for name, width in (("left", 80), ("right", 100)):
        Image.new("RGB", (width, 60)).save(tmp_path / f"{name}.png")
    cropped = load_photos([tmp_path / "left.png", tmp_path / "right.png"])
    points = read(cropped, "--point", "20,16.5", "--not-point", "2:0.5,0.25")
    assert points.positive[0] == pytest.approx((0, 0.25, 0.25))
    assert points.negative[0] == pytest.approx((1, 0.5, 0.25))
    boxes = read(cropped, "--box", "20,16.5,40,13.5", "--box", "2:0,15,50,15").boxes
    assert boxes[0] == pytest.approx((0.25, 0.25, 0.5, 0.25))
    assert boxes[1] == pytest.approx((0, 0.25, 0.5, 0.25))
    with pytest.raises(
        InputError, match="x from 6 to 94 and y from 0 to 60 of its 100"
    ):
        read(cropped, "--point", "2:5,30")


def test_places_and_masks_on_photos_of_a_bent_lens_follow_them(tmp_path):
    lens = {"w": 60, "h": 40, "fl_x": 45.0, "k1": -0.3}
    Image.new("RGB", (240, 160)).save(tmp_path / "a.png")
    Image.new("RGB", (240, 160), "red").save(tmp_path / "b.png")
    frames = [{"file_path": name} for name in ("a.png", "b.png")]
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    bent = load_photos([tmp_path / "a.png", tmp_path / "b.png"], size=60)
    ((_, x, y),) = read(bent, "--point", "0.1,0.15").positive
    # barrel distortion had drawn it to the middle
    assert x < 0.1 - 0.01 and y < 0.15 - 0.01
    left, _, width, _ = read(bent, "--box", "0.1,0.15,0.8,0.7").boxes[0]
    assert left == pytest.approx(x, abs=1e-3) and width == pytest.approx(
        1 - 2 * x, abs=2e-3
    )
    mask = Image.new("L", (240, 160))
    mask.paste(255, (16, 16, 32, 32))  # around the place
    mask.save(tmp_path / "a_mask.png")
    (found,) = read(bent, "--mask", str(tmp_path / "a_mask.png")).masks.values()
    _, columns = (found > 0.5).nonzero(as_tuple=True)
    assert float(columns.float().mean() + 0.5) / 60 == pytest.approx(x, abs=0.02)
