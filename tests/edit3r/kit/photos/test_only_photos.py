"""Masks, sheets of ours and a photo's second format are no photos of a scene."""

import numpy as np
import pytest
from PIL import Image

from edit3r.contract.errors import MissingDependencyError
from edit3r.kit.photos import only_photos
from edit3r.kit.photos.images import find_photos, save_pixels


@pytest.fixture
def folder(tmp_path):
    for seed, name in enumerate(("left.jpg", "right.jpg")):
        Image.fromarray(picture(seed)).save(tmp_path / name, quality=95)
    return tmp_path


def picture(seed, size=48):
    coarse = np.random.default_rng(seed).integers(0, 255, (6, 8, 3), dtype=np.uint8)
    return np.asarray(Image.fromarray(coarse).resize((size, size)))


def picture_of(seed):
    return Image.fromarray(picture(seed))


def names(folder):
    return [file.name for file in find_photos(folder)]


@pytest.mark.parametrize(
    "name",
    [
        "left_mask.png",
        "right-mask.png",
        "mask_left.png",
        "left.mask.png",
        "left_tiefe.png",
        "left_depth_16.png",
        "seg-right.png",
        "left.jpg.png",
    ],
)
@pytest.mark.parametrize("kind", ["L", "RGBA", "labels"])
def test_a_mask_or_map_beside_its_photo_is_no_photo_whatever_the_word(
    folder, name, kind
):
    grey = Image.open(folder / "left.jpg").convert("L")
    mask = (
        Image.merge("RGBA", (*picture_of(7).split(), grey)) if kind == "RGBA" else grey
    )
    if kind == "labels":
        mask = grey.point(lambda value: 255 * (value > 128)).convert("RGB")
        mask = Image.merge(
            "RGB", (mask.split()[0], *Image.new("RGB", mask.size).split()[:2])
        )
    mask.save(folder / name)
    assert names(folder) == ["left.jpg", "right.jpg"]
    assert len(find_photos(sorted(folder.iterdir()))) == 2  # as a shell lists them


@pytest.mark.parametrize("name", ["left.png", "left.webp"])
def test_a_photo_in_a_second_format_is_no_second_photo(folder, name):
    Image.open(folder / "left.jpg").save(folder / name)
    assert len(names(folder)) == 2


def test_photos_in_grey_are_photos(tmp_path):
    for seed, name in enumerate(("left.jpg", "left_2.jpg")):
        picture_of(seed).convert("L").save(tmp_path / name)
    assert len(names(tmp_path)) == 2


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_what_was_made_here_is_told_whatever_it_is_called(folder, suffix):
    save_pixels(picture(2), folder / f"a{suffix}", is_photo=False)
    assert names(folder) == ["left.jpg", "right.jpg"]
    save_pixels(picture(3), folder / f"b{suffix}")
    assert names(folder) == [f"b{suffix}", "left.jpg", "right.jpg"]


def test_the_format_with_most_pixels_is_taken(folder):
    Image.fromarray(picture(0, 96)).save(folder / "left.png")
    assert names(folder) == ["left.png", "right.jpg"]


@pytest.mark.parametrize(
    "name",
    [
        "left (1).jpg",
        "left 2.jpg",
        "left~2.jpg",
        "left_thumb.jpg",
        "left - Copy.jpg",
        "left - Kopie (2).jpg",
        "Copy of left.jpg",
        "left copy 2.jpg",
        "left-edited.jpg",
    ],
)
def test_copies_are_no_photos_but_others_of_such_names_are(folder, name):
    copy = Image.open(folder / "left.jpg").resize((40, 40)).point(lambda v: 0.9 * v)
    copy.save(folder / name, quality=95)
    assert names(folder) == ["left.jpg", "right.jpg"]
    Image.fromarray(np.roll(picture(0), 3, axis=1)).save(folder / name)
    assert len(names(folder)) == 3


def test_numbers_in_brackets_alone_are_no_copies(folder):
    for number in (1, 2):
        Image.open(folder / "left.jpg").save(folder / f"photo ({number}).jpg")
    Image.open(folder / "left.jpg").save(folder / "IMG_0004.jpg")
    Image.open(folder / "left.jpg").save(folder / "IMG_E0004.jpg")
    assert len(names(folder)) == 5


def test_another_photo_of_that_name_stays(folder):
    Image.fromarray(picture(5)).save(folder / "left.png")
    assert names(folder) == ["left.jpg", "left.png", "right.jpg"]


def test_a_photo_called_mask_stays(folder):
    Image.fromarray(picture(5)).save(folder / "venice_mask.jpg")
    assert len(names(folder)) == 3


@pytest.mark.parametrize("name", ["left copy.jpg", "Copy of left.jpg"])
def test_of_a_copy_with_as_many_pixels_the_photo_it_is_named_after_is_taken(
    folder, name
):
    (folder / name).write_bytes((folder / "left.jpg").read_bytes())
    assert names(folder) == ["left.jpg", "right.jpg"]


@pytest.mark.parametrize(
    ("heic", "kept"),
    [
        ("left.heic", {"left.jpg", "right.jpg"}),  # one photo in two formats
        ("lef.heic", {"lef.heic", "left.jpg", "right.jpg"}),
        ("left_2.heic", {"left_2.heic", "left.jpg", "right.jpg"}),  # perhaps another
    ],
)
def test_what_cannot_be_read_here_is_left_out_only_beside_its_own_name(
    folder, monkeypatch, heic, kept
):
    (folder / heic).write_bytes(b"")

    def image_size(file):
        if file.suffix == ".heic":
            raise MissingDependencyError("needs pi_heif")
        return (48, 48)

    monkeypatch.setattr(only_photos, "image_size", image_size)
    monkeypatch.setattr(only_photos, "_is_map_of", lambda file, other: False)
    assert set(names(folder)) == kept
