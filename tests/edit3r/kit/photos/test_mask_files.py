"""Masks find their photos by name, from files, folders and wildcards."""

import pytest
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos.masks import masks_by_photo, photo_named

PHOTOS = [("img2.jpg",), ("img10.jpg",)]


@pytest.fixture
def masks(tmp_path):
    def write(*names):
        for name in names:
            file = tmp_path / name
            file.parent.mkdir(exist_ok=True, parents=True)
            Image.new("L", (4, 4), 255).save(file, format="PNG")
        return [str(tmp_path / name) for name in names]

    return write


def paired(given, photos=PHOTOS):
    return [found.name for found in masks_by_photo(given, photos).values()]


@pytest.mark.parametrize(
    "names",
    [
        ("img10_mask.png", "img2_mask.png"),  # as a shell sorts them
        ("img10.png", "img2.png"),
        ("img10.jpg.png", "img2.jpg.png"),
        ("mask_img10.png", "mask_img2.png"),
        ("IMG10-mask.PNG", "IMG2-mask.PNG"),
        ("maskimg10.png", "maskimg2.png"),
        ("seg-img10-0.png", "seg-img2-0.png"),
        ("mask_10.png", "mask_2.png"),  # by the photos' numbers
        ("00010.png", "00002.png"),
        ("img10.gif", "img2.gif"),
    ],
)
@pytest.mark.parametrize("how", ["files", "folder", "wildcard"])
def test_each_goes_to_the_photo_of_its_name(masks, tmp_path, names, how):
    files = masks(*names)
    masks("preview.png")
    given = {
        "files": files,
        "folder": [str(tmp_path)],
        "wildcard": [str(tmp_path / "*[02]*")],
    }
    assert paired(given[how]) == list(names[::-1])


def test_how_a_folder_was_paired_is_said(masks, tmp_path):
    masks("img2_mask.png", "img10_mask.png")
    called = [("img2.jpg", "left"), ("img10.jpg", "right")]
    with collecting(Report()) as report:
        masks_by_photo([str(tmp_path)], called)
    pairs = "img2.jpg <- img2_mask.png, img10.jpg <- img10_mask.png"
    assert report.notes["selection.masks"] == f"paired with the photos by name: {pairs}"


@pytest.mark.parametrize("given", ["", "*/1.png", "*"])
def test_each_in_a_folder_called_like_its_photo_is_that_photos(masks, tmp_path, given):
    masks("img10/1.png", "img2/1.png", "other/1.png" if given == "" else "img2/1.png")
    found = masks_by_photo([str(tmp_path / given)], PHOTOS[::-1])
    assert [file.parent.name for file in found.values()] == ["img10", "img2"]


def test_several_in_a_photos_folder_are_asked_about(masks, tmp_path):
    """As Segment Anything writes them: which thing is meant?"""
    masks("img10/0.png", "img10/1.png", "img2/0.png")
    with pytest.raises(InputError, match=r"2 masks of one photo.*--mask \S+img2.0.png"):
        paired([str(tmp_path)])


def test_img10_is_not_named_after_img1(masks):
    # a single one, of no photo's name: the first photo's
    assert paired(masks("img10_mask.png"), [("img1.jpg",), ("img2.jpg",)]) == [
        "img10_mask.png"
    ]
    (view,) = masks_by_photo(masks("img10_m.png"), [("img1.jpg",), ("img10.jpg",)])
    assert view == 1


def test_of_few_masks_each_goes_to_its_number(masks):
    photos = [(f"IMG_{number}.jpg",) for number in (1, 2, 3)]
    for names, views in ((("mask_2.png",), [1]), (("m_3.png", "m_2.png"), [1, 2])):
        assert list(masks_by_photo(masks(*names), photos)) == views


@pytest.mark.parametrize("first", [0, 1])
def test_as_many_as_photos_that_count_otherwise_go_in_order(masks, tmp_path, first):
    """Of a video's segmenter, which counts from 0."""
    photos = [(f"IMG_{number}.jpg",) for number in (1 + first, 2 + first)]
    names = [f"{number:05}.png" for number in (first, 1 + first)]
    masks(*names)
    assert paired([str(tmp_path)], photos) == names


def test_what_a_shell_sorted_goes_in_natural_order(masks):
    photos = [(f"{name}.jpg",) for name in "abcdefghijk"]
    by_shell = sorted(f"m{number}.png" for number in range(11))
    assert paired(masks(*by_shell), photos) == [f"m{i}.png" for i in range(11)]
    by_hand = [f"m{i}.png" for i in (*range(1, 11), 0)]
    assert paired(masks(*by_hand), photos) == by_hand


def test_a_mask_that_two_photos_names_fit_alike_is_no_photos_by_name(masks):
    photos = [("ab.jpg",), ("cd.jpg",)]
    assert paired(masks("ab_cd.png", "ab.png"), photos) == ["ab.png", "ab_cd.png"]


def test_two_masks_of_one_photo_are_an_error(masks):
    with pytest.raises(InputError, match="2 masks for 2 photos"):
        masks_by_photo(masks("img2_a.png", "img2_b.png"), PHOTOS)


def test_other_names_go_in_the_order_given(masks):
    given = masks("b.png", "x.png")
    assert paired(given, [("left.jpg",), ("right.jpg",)]) == ["b.png", "x.png"]
    mixed = masks("right_mask.png", "thing.png")
    assert paired(mixed, [("left.jpg",), ("right.jpg",)]) == [
        "thing.png",
        "right_mask.png",
    ]


def test_masks_of_photos_that_are_not_used_are_left(masks):
    given = masks("img1_m.png", "img2_m.png", "img3_m.png", "img10_m.png")
    assert paired(given) == ["img2_m.png", "img10_m.png"]


def test_what_fits_no_photo_is_an_error_with_the_way_out(masks, tmp_path):
    three = [*PHOTOS, ("c.jpg",)]
    with pytest.raises(InputError, match=r"2 masks for 3 photos.*name each after"):
        masks_by_photo(masks("x.png", "y.png"), three)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no images in this folder"):
        masks_by_photo([str(tmp_path / "empty")], three)
    with pytest.raises(InputError, match="no such file"):
        masks_by_photo([str(tmp_path / "no*.png")], three)


def test_a_number_goes_on_in_another_name():
    assert photo_named("img1_mask", [("img1.jpg",)]) == 0
    assert photo_named("img10_mask", [("img1.jpg",)]) is None
