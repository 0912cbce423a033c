import io
import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import ExifTags, Image, ImageCms

import edit3r
from edit3r.errors import InputError, MissingDependencyError
from edit3r.io.decode import MAX_PIXELS, decode, image_size, read_image
from edit3r.reporting import Report, collecting


@pytest.fixture
def pattern():
    """20 x 12 with a different colour in each corner, smooth enough for JPEG."""
    ys, xs = np.mgrid[0:12, 0:20]
    return np.stack((xs * 12, ys * 20, 255 - xs * 6 - ys * 6), -1).astype(np.uint8)


def difference(path, expected):
    return np.abs(np.asarray(read_image(path)).astype(int) - expected.astype(int)).max()


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.bmp", "a.ppm"])
def test_lossless_formats_come_back_bit_equal(tmp_path, pattern, name):
    Image.fromarray(pattern).save(tmp_path / name)
    assert difference(tmp_path / name, pattern) == 0


@pytest.mark.parametrize("name", ["a.jpg", "a.webp", "a.avif"])
def test_lossy_formats_come_back_close(tmp_path, pattern, name):
    Image.fromarray(pattern).save(tmp_path / name, quality=98)
    assert difference(tmp_path / name, pattern) < 30


@pytest.mark.parametrize("orientation", range(1, 9))
def test_all_exif_orientations_come_back_upright(tmp_path, pattern, orientation):
    # What a camera stores when held so that `orientation` describes it (EXIF 2.3, tag 274).
    stored = {
        1: pattern,
        2: pattern[:, ::-1],
        3: pattern[::-1, ::-1],
        4: pattern[::-1],
        5: pattern.transpose(1, 0, 2),
        6: np.rot90(pattern, 1),
        7: pattern[::-1, ::-1].transpose(1, 0, 2),
        8: np.rot90(pattern, -1),
    }[orientation]
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / "a.png", exif=exif)
    assert difference(tmp_path / "a.png", pattern) == 0
    assert image_size(tmp_path / "a.png") == (12, 20)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_sixteen_bit_colour_keeps_its_high_byte(tmp_path, pattern, suffix):
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), (pattern[..., ::-1].astype(np.uint16) << 8) + 77)
    assert difference(path, pattern) == 0


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_sixteen_bit_grey_keeps_its_high_byte(tmp_path, pattern, suffix):
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), (pattern[..., 0].astype(np.uint16) << 8) + 255)
    assert difference(path, pattern[..., :1].repeat(3, -1)) == 0


@pytest.mark.parametrize("mode", ["L", "1", "P"])
def test_grey_bitmap_and_palette_become_rgb(tmp_path, pattern, mode):
    image = Image.fromarray(pattern).convert(mode)
    image.save(tmp_path / "a.png")
    assert difference(tmp_path / "a.png", np.asarray(image.convert("RGB"))) == 0


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
def test_alpha_is_laid_over_white(tmp_path, mode):
    image = Image.new("RGBA", (3, 1), (0, 0, 0, 255))
    image.putpixel((1, 0), (0, 0, 0, 0))
    image.putpixel((2, 0), (100, 100, 100, 128))
    image.convert(mode).save(tmp_path / "a.png")
    np.testing.assert_allclose(
        np.asarray(read_image(tmp_path / "a.png"))[0, :, 0], [0, 255, 177], atol=1
    )


def test_transparent_palette_entry_is_white(tmp_path):
    image = Image.new("P", (2, 1))
    image.putpalette([10, 20, 30, 200, 0, 0])
    image.putpixel((1, 0), 1)
    image.save(tmp_path / "a.png", transparency=1)
    assert np.asarray(read_image(tmp_path / "a.png")).tolist() == [
        [[10, 20, 30], [255, 255, 255]]
    ]


@pytest.mark.parametrize("suffix", ["jpg", "tif"])
def test_cmyk_shows_the_right_colours(tmp_path, suffix):
    Image.new("CMYK", (16, 16), (0, 255, 255, 0)).save(
        tmp_path / f"a.{suffix}", quality=95
    )
    red = np.asarray(read_image(tmp_path / f"a.{suffix}"))[8, 8]
    assert red[0] > 240 and red[1] < 15 and red[2] < 15


def test_colour_profile_is_converted_to_srgb(tmp_path):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    # The same space with its red and green primaries swapped, under another name.
    swapped = srgb.replace("sRGB".encode("utf-16-be"), "tRGB".encode("utf-16-be"))
    swapped = (
        swapped.replace(b"rXYZ", b"????")
        .replace(b"gXYZ", b"rXYZ")
        .replace(b"????", b"gXYZ")
    )
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "a.png", icc_profile=swapped)
    np.testing.assert_allclose(
        np.asarray(read_image(tmp_path / "a.png"))[0, 0], [0, 255, 0], atol=3
    )


def test_srgb_profile_changes_nothing_and_a_broken_one_is_warned_of(tmp_path, pattern):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(pattern).save(tmp_path / "a.png", icc_profile=srgb)
    assert difference(tmp_path / "a.png", pattern) == 0
    Image.fromarray(pattern).save(tmp_path / "b.png", icc_profile=b"nonsense")
    with collecting(Report()) as report:
        assert difference(tmp_path / "b.png", pattern) == 0
    assert "b.png: its colour profile cannot be used" in report.warnings[0]


def test_content_decides_not_the_name(tmp_path, pattern):
    Image.fromarray(pattern).save(tmp_path / "a.png")
    (tmp_path / "a.png").rename(tmp_path / "a.jpg")
    assert difference(tmp_path / "a.jpg", pattern) == 0


def test_first_of_several_frames_is_used_with_a_warning(tmp_path):
    frames = [Image.new("RGB", (4, 4), colour) for colour in ("red", "blue")]
    frames[0].save(tmp_path / "a.tif", save_all=True, append_images=frames[1:])
    with collecting(Report()) as report:
        assert read_image(tmp_path / "a.tif").getpixel((0, 0)) == (255, 0, 0)
    assert "holds 2 pictures" in report.warnings[0]


def complain(path):
    """The sentence for a bad file: one, naming it."""
    with pytest.raises(InputError) as caught:
        decode(path)
    text = str(caught.value)
    assert str(path) in text and "\n" not in text and caught.value.exit_code == 2
    return text


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tif", "bmp"])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_truncated_file_is_one_sentence(tmp_path, suffix, share):
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    assert "damaged" in complain(path) or "not a picture" in complain(path)


def test_empty_file_text_folder_and_missing_file_are_one_sentence_each(tmp_path):
    (tmp_path / "empty.jpg").touch()
    assert "empty" in complain(tmp_path / "empty.jpg")
    (tmp_path / "text.jpg").write_text("These are not pixels. " * 100)
    assert "not a picture" in complain(tmp_path / "text.jpg")
    assert "folder" in complain(tmp_path)
    assert "no such file" in complain(tmp_path / "none.jpg")


def chunk(name, data):
    return (
        struct.pack(">I", len(data))
        + name
        + data
        + struct.pack(">I", zlib.crc32(name + data))
    )


@pytest.mark.parametrize("side", [12_000, 60_000])
def test_decompression_bomb_is_refused_before_it_is_unpacked(tmp_path, side):
    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    data = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(bytes(1000)))
    )
    (tmp_path / "bomb.png").write_bytes(data + chunk(b"IEND", b""))
    assert side * side > MAX_PIXELS
    assert "megapixels" in complain(tmp_path / "bomb.png")


def test_heic_without_the_package_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pi_heif", None)
    (tmp_path / "IMG_1.HEIC").write_bytes(
        struct.pack(">I", 24) + b"ftypheic" + bytes(100)
    )
    with pytest.raises(
        MissingDependencyError, match=r'IMG_1.HEIC.*pip install "edit3r\[heic\]"'
    ):
        decode(tmp_path / "IMG_1.HEIC")


def exif_photo(tmp_path, size=(400, 300), **tags):
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif).update(
        {ExifTags.Base[name]: value for name, value in tags.items()}
    )
    Image.new("RGB", size).save(tmp_path / "a.jpg", exif=exif)
    return decode(tmp_path / "a.jpg")


def test_focal_from_the_35_mm_equivalent_goes_by_the_diagonal(tmp_path):
    picture = exif_photo(tmp_path, FocalLengthIn35mmFilm=43)
    assert picture.focal == pytest.approx(500 * 43 / 43.2666, rel=1e-4)
    assert picture.focal_source == "EXIF 35 mm equivalent (43 mm)"


def test_focal_from_focal_length_and_sensor_resolution(tmp_path):
    # 4000 pixels recorded on a sensor of 100 pixels per mm; the file was scaled to a tenth since.
    tags = dict(
        FocalLength=20.0,
        FocalPlaneXResolution=1000.0,
        FocalPlaneResolutionUnit=3,
        ExifImageWidth=4000,
    )
    picture = exif_photo(tmp_path, **tags)
    assert picture.focal == pytest.approx(20 * 100 / 10)
    assert "sensor" in picture.focal_source


@pytest.mark.parametrize("value", [0, 60000])
def test_impossible_exif_focal_is_ignored(tmp_path, value):
    assert exif_photo(tmp_path, FocalLengthIn35mmFilm=value).focal is None


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_damaged_files_never_raise_anything_but_input_errors(tmp_path_factory, data):
    buffer = io.BytesIO()
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 28
    kind = data.draw(st.sampled_from(["JPEG", "PNG", "WEBP", "TIFF"]))
    Image.linear_gradient("L").resize((24, 24)).convert("RGB").save(
        buffer, kind, exif=exif
    )
    content = bytearray(buffer.getvalue())
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(
            st.integers(0, 255)
        )
    path = tmp_path_factory.mktemp("damaged") / "a.jpg"
    path.write_bytes(content)
    try:
        decode(path)
    except InputError as error:
        assert str(path) in str(error)


def test_a_file_that_would_start_another_program_is_not_read_whatever_its_name(
    tmp_path, monkeypatch
):
    """Pillow draws EPS by calling Ghostscript."""
    monkeypatch.setattr(
        "subprocess.check_call", lambda *_, **__: pytest.fail("started a program")
    )
    path = tmp_path / "a.jpg"
    Image.new("RGB", (4, 4)).save(path, "EPS")
    assert "not a picture" in complain(path)


def test_pillow_is_always_told_what_a_file_may_be():
    """For a file that it takes for EPS it would start Ghostscript."""
    root = Path(edit3r.__file__).parents[1]
    calls = [
        (file, call)
        for folder in ("edit3r", "plugins")
        for file in (root / folder).rglob("*.py")
        for call in re.findall(r"Image\.open\(.*", file.read_text(encoding="utf-8"))
    ]
    assert calls and not [
        (file, call) for file, call in calls if "formats=" not in call
    ]
