import base64
import re
import struct
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import ExifTags, Image, ImageCms, TiffImagePlugin
from PIL.PngImagePlugin import PngInfo

import edit3r
from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos.decode import decode, image_size, read_header, read_image
from edit3r.kit.photos.images import find_photos


@pytest.fixture
def pattern():
    """20 x 12 with a different colour in each corner, smooth enough for JPEG."""
    ys, xs = np.mgrid[0:12, 0:20]
    return np.stack((xs * 12, ys * 20, 255 - xs * 6 - ys * 6), -1).astype(np.uint8)


def difference(path, expected):
    return np.abs(np.asarray(read_image(path)).astype(int) - expected.astype(int)).max()


@pytest.mark.parametrize(
    ("suffix", "wrong"),
    {"png": 0, "tif": 0, "bmp": 0, "ppm": 0, "jpg": 30, "webp": 30, "avif": 30}.items(),
)
def test_every_format_comes_back_and_content_decides_not_the_name(
    tmp_path, pattern, suffix, wrong
):
    Image.fromarray(pattern).save(tmp_path / f"a.{suffix}", quality=98)
    (tmp_path / f"a.{suffix}").rename(tmp_path / "photo.jpg")
    assert difference(tmp_path / "photo.jpg", pattern) <= wrong


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
    for name in ("a.png", "a.tif"):  # Pillow turns TIFFs by itself
        Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / name, exif=exif)
        assert difference(tmp_path / name, pattern) == 0
        assert image_size(tmp_path / name) == (12, 20)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_sixteen_bits_keep_their_high_byte_or_are_those_of_eight(
    tmp_path, pattern, suffix, channels
):
    path = tmp_path / f"a.{suffix}"
    alpha = np.full_like(pattern[..., :1], 255)
    pixels = np.concatenate((pattern, alpha), 2)[..., [2, 1, 0, 3][:channels]]
    shown = pattern if channels > 1 else pattern[..., 2:].repeat(3, -1)
    deep = pixels.astype(np.uint16)
    for values in (deep * 257, (deep << 8) + 77, deep):
        if channels == 4:
            values[..., 3] = 65535 if values.max() > 255 else 255
        cv2.imwrite(str(path), values)
        with collecting(Report()) as report:
            assert difference(path, shown) == 0
        assert bool(report.warnings) == (values.max() <= 255)


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
    assert difference(tmp_path / "a.png", np.array([[[0], [255], [177]]])) <= 1


def test_transparent_palette_entry_is_white(tmp_path):
    image = Image.new("P", (2, 1))
    image.putpalette([10, 20, 30, 200, 0, 0])
    image.putpixel((1, 0), 1)
    image.save(tmp_path / "a.png", transparency=1)
    assert difference(tmp_path / "a.png", np.array([[[10, 20, 30], [255] * 3]])) == 0


@pytest.mark.parametrize("suffix", ["jpg", "tif"])
def test_cmyk_shows_the_right_colours(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    Image.new("CMYK", (16, 16), (0, 255, 255, 0)).save(path, quality=95)
    assert difference(path, np.array([255, 0, 0])) < 15


def test_colour_profile_is_converted_to_srgb(tmp_path):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    # The same space with its red and green primaries swapped, under another name.
    swapped = srgb.replace("sRGB".encode("utf-16-be"), "tRGB".encode("utf-16-be"))
    for old, new in ((b"rXYZ", b"????"), (b"gXYZ", b"rXYZ"), (b"????", b"gXYZ")):
        swapped = swapped.replace(old, new)
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "a.png", icc_profile=swapped)
    assert difference(tmp_path / "a.png", np.array([0, 255, 0])) <= 3


def test_srgb_profile_changes_nothing_and_a_broken_one_is_warned_of(tmp_path, pattern):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(pattern).save(tmp_path / "a.png", icc_profile=srgb)
    assert difference(tmp_path / "a.png", pattern) == 0
    Image.fromarray(pattern).save(tmp_path / "b.png", icc_profile=b"nonsense")
    with collecting(Report()) as report:
        assert difference(tmp_path / "b.png", pattern) == 0
    assert "b.png: its colour profile cannot be used" in report.warnings[0]


def test_the_first_of_several_images_is_used_and_the_others_are_not_counted(
    tmp_path, monkeypatch
):
    """Counting the pages of a TIFF can take minutes."""
    counted = property(lambda _: pytest.fail("counted the pages"))
    monkeypatch.setattr("PIL.TiffImagePlugin.TiffImageFile.n_frames", counted)
    first, second = (Image.new("RGB", (4, 4), colour) for colour in ("red", "blue"))
    first.save(tmp_path / "a.tif", save_all=True, append_images=[second])
    with collecting(Report()) as report:
        assert read_image(tmp_path / "a.tif").getpixel((0, 0)) == (255, 0, 0)
    assert "holds several images" in report.warnings[0]


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
    assert "damaged" in complain(path) or "not an image" in complain(path)


def test_empty_file_text_folder_and_missing_file_are_one_sentence_each(tmp_path):
    (tmp_path / "empty.jpg").touch()
    assert "empty" in complain(tmp_path / "empty.jpg")
    (tmp_path / "text.jpg").write_text("These are not pixels. " * 100)
    assert "not an image" in complain(tmp_path / "text.jpg")
    assert "folder" in complain(tmp_path)
    assert "no such file" in complain(tmp_path / "none.jpg")


def png_of(side):
    """A PNG whose header promises side x side pixels."""
    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b""))
    content = b"\x89PNG\r\n\x1a\n"
    for name, data in chunks:
        checksum = struct.pack(">I", zlib.crc32(name + data))
        content += struct.pack(">I", len(data)) + name + data + checksum
    return content


def tiff_of_strips(side, count):
    """A grey TIFF of many strips, each half of the image, that are all the same bytes."""
    end = 8 + 2 + 8 * 12 + 4
    long, short = 4, 3
    tags = (
        (256, short, 1, side),
        (257, short, 1, side),
        (258, short, 1, 8),
        (262, short, 1, 1),
        (273, long, count, end),
        (277, short, 1, 1),
        (278, short, 1, side // 2),
        (279, long, count, end),
    )
    content = b"II*\0" + struct.pack("<IH", 8, len(tags))
    content += b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    return content + struct.pack("<I", 8) * count


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (png_of(12_000), "megapixels"),
        (png_of(60_000), "megapixels"),
        (tiff_of_strips(1000, 100_000), "pieces that cover each other"),
    ],
    ids=["pixels", "more pixels", "strips"],
)
def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path, content, sentence):
    (tmp_path / "bomb").write_bytes(content)
    start = time.process_time()
    assert sentence in complain(tmp_path / "bomb")
    assert time.process_time() - start < 2


def test_heic_without_the_package_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pi_heif", None)
    (tmp_path / "IMG_1.HEIC").write_bytes(
        struct.pack(">I", 24) + b"ftypheic" + bytes(100)
    )
    with pytest.raises(
        MissingDependencyError, match=r'IMG_1.HEIC.*pip install "edit3r\[heic\]"'
    ):
        decode(tmp_path / "IMG_1.HEIC")


# 48x32: black and white above white and grey, as libheif's own encoder writes it.
HEIC = base64.b64decode(
    "AAAAHGZ0eXBoZWljAAAAAG1pZjFoZWljbWlhZgAAAb5tZXRhAAAAAAAAACFoZGxyAAAAAAAAAABwaWN0"
    "AAAAAAAAAAAAAAAAAAAAADRpbG9jAAAAAERAAAIAAQAAAAAB4gABAAAAAAAAAC8AAgAAAAACEQABAAAA"
    "AAAAACQAAAA4aWluZgAAAAAAAgAAABVpbmZlAgAAAAABAABodmMxAAAAABVpbmZlAgAAAQACAABFeGlm"
    "AAAAAA5waXRtAAAAAAABAAAA/WlwcnAAAADdaXBjbwAAAHZodmNDAQNwAAAAkAAAAAAAHvAA/P34+AAA"
    "DwNgAAEAGEABDAH//wNwAAADAJAAAAMAAAMAHroCQGEAAQAqQgEBA3AAAAMAkAAAAwAAAwAeoCCBBZbq"
    "5Ka5uAhoMCAAAAMDIAAAAwAhYgABAAZEAcFzwIkAAAATY29scm5jbHgAAQANAAaAAAAAFGlzcGUAAAAA"
    "AAAAQAAAAEAAAAAoY2xhcAAAADAAAAABAAAAIAAAAAH////wAAAAAv///+AAAAACAAAAEHBpeGkAAAAA"
    "AwgICAAAABhpcG1hAAAAAAAAAAEAAQWBAgMFhAAAABppcmVmAAAAAAAAAA5jZHNjAAIAAQABAAAAW21k"
    "YXQAAAArKAGvE4Dl/E//7WmBVmcfNejMwfan9nIM3yn/hrCT2vY+uuPJRb9ikVciWgAAAAZFeGlmAABN"
    "TQAqAAAACAABARIAAwAAAAEABgAAAAAAAA=="
)


@pytest.mark.parametrize("name", ["IMG_1.HEIC", "IMG_1.jpg"])
def test_heic_is_read_with_the_package_whatever_it_is_called(tmp_path, name):
    pytest.importorskip("pi_heif")
    (tmp_path / name).write_bytes(HEIC)
    assert image_size(tmp_path / name) == (32, 48)
    pixels = decode(tmp_path / name).pixels
    corners = [pixels.getpixel(place)[0] for place in ((4, 4), (40, 4), (40, 28))]
    assert corners == pytest.approx([0, 255, 128], abs=4)


def exif_photo(tmp_path, size=(400, 300), **tags):
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif).update(
        {ExifTags.Base[name]: value for name, value in tags.items()}
    )
    Image.new("RGB", size).save(tmp_path / "a.jpg", exif=exif)
    return read_header(tmp_path / "a.jpg")


def test_focal_from_the_35_mm_equivalent_goes_by_the_diagonal(tmp_path):
    image = exif_photo(tmp_path, FocalLengthIn35mmFilm=43)
    assert image.focal == pytest.approx(500 * 43 / 43.2666, rel=1e-4)
    assert image.focal_source == "EXIF 35 mm equivalent (43 mm)"


def test_focal_from_focal_length_and_sensor_resolution(tmp_path):
    image = exif_photo(
        tmp_path,
        FocalLength=20.0,
        FocalPlaneXResolution=1000.0,  # 100 pixels per mm
        FocalPlaneResolutionUnit=3,
        ExifImageWidth=4000,  # the file was scaled to a tenth since
    )
    assert image.focal == pytest.approx(20 * 100 / 10)
    assert "sensor" in image.focal_source


@pytest.mark.parametrize("value", [0, 60000])
def test_impossible_exif_focal_is_ignored(tmp_path, value):
    assert exif_photo(tmp_path, FocalLengthIn35mmFilm=value).focal is None


def test_a_file_that_would_start_another_program_is_not_read_whatever_its_name(
    tmp_path, monkeypatch
):
    """Pillow draws EPS by calling Ghostscript."""
    monkeypatch.setattr(
        "subprocess.check_call", lambda *_, **__: pytest.fail("started a program")
    )
    path = tmp_path / "a.jpg"
    Image.new("RGB", (4, 4)).save(path, "EPS")
    assert "not an image" in complain(path)


def test_pillow_is_always_told_what_a_file_may_be():
    """For a file that it takes for EPS it would start Ghostscript."""
    root = Path(edit3r.__file__).parents[1]
    files = [*(root / "edit3r").rglob("*.py"), *(root / "plugins").rglob("*.py")]
    source = "".join(file.read_text(encoding="utf-8") for file in files)
    calls = re.findall(r"Image\.open\(.*", source)
    assert calls and all("formats=" in call for call in calls), calls


@pytest.mark.parametrize(
    ("size", "recorded", "believed"),
    [
        ((400, 300), (4032, 3024), True),
        ((300, 400), (4032, 3024), True),  # turned, the tags are not
        ((400, 300), None, True),
        ((400, 400), (4032, 3024), False),
        ((400, 225), (4032, 3024), False),
        ((800, 300), (8000, 3000), False),  # a panorama
    ],
)
def test_a_cropped_photo_does_not_know_its_lens(tmp_path, size, recorded, believed):
    exif = Image.Exif()
    tags = exif.get_ifd(ExifTags.IFD.Exif)
    tags[ExifTags.Base.FocalLengthIn35mmFilm] = 26
    if recorded:
        tags[ExifTags.Base.ExifImageWidth], tags[ExifTags.Base.ExifImageHeight] = (
            recorded
        )
    Image.new("RGB", size, "grey").save(tmp_path / "a.jpg", exif=exif)
    header = read_header(tmp_path / "a.jpg")
    assert (header.focal is not None) == believed
    told = ["not believed; --fov" in text for text in header.remarks]
    assert told == [True] * (not believed)


@pytest.mark.parametrize(
    ("name", "tags"),
    [
        ("a.dng", {50706: b"\1\4\0\0"}),
        ("a.tif", {50706: b"\1\4\0\0"}),  # told by content
        ("a.nef", {254: 1}),
        ("a.arw", {}),
    ],
)
def test_a_raw_file_is_no_thumbnail(tmp_path, pattern, name, tags):
    known = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, value in tags.items():
        known[tag] = value
        if isinstance(value, bytes):
            known.tagtype[tag] = 1
    path = tmp_path / name
    Image.fromarray(pattern).save(path, format="TIFF", tiffinfo=known)
    for read in (decode, image_size):
        with pytest.raises(InputError, match=r"raw file.*develop.*JPEG or TIFF"):
            read(path)


def test_a_folder_that_has_no_images_says_what_it_has(tmp_path, pattern):
    (tmp_path / "a.CR3").write_bytes(b"raw")
    with pytest.raises(InputError, match=r"only raw files \(a.CR3\); develop"):
        find_photos(tmp_path)
    (tmp_path / "a.CR3").unlink()
    (tmp_path / "front").mkdir()
    Image.fromarray(pattern).save(tmp_path / "front" / "1.png")
    with pytest.raises(InputError, match=r"no images.*but in .*front: give"):
        find_photos(tmp_path)
    assert len(find_photos(str(tmp_path / "fr*" / "*.png"))) == 1


def tiff(path, kind):
    """A file that Pillow reads wrongly, without a word."""
    deep = (np.arange(30 * 40 * 3).reshape(30, 40, 3) * 18).astype(np.uint16)
    if kind == "planar":
        tifffile.imwrite(path, deep.transpose(2, 0, 1), planarconfig="separate")
        return
    white = "miniswhite" if kind == "white is zero" else "minisblack"
    tifffile.imwrite(path, deep[..., 0], photometric=white, rowsperstrip=10)
    with tifffile.TiffFile(path, mode="r+b") as file:
        tags = file.pages[0].tags
        if kind == "12 bits":
            tags["BitsPerSample"].overwrite(12)
        if kind == "an empty strip":
            tags["StripByteCounts"].overwrite([800, 0, 800])
        if kind == "a strip too few":
            tags["ImageLength"].overwrite(50)


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("planar", "each channel by itself"),
        ("white is zero", "0 as white"),
        ("12 bits", "12 bits per channel"),
        ("an empty strip", "parts of the image are missing"),
        ("a strip too few", "parts of the image are missing"),
    ],
)
def test_a_tiff_that_would_be_read_wrongly_is_refused(tmp_path, kind, told):
    tiff(tmp_path / "a.tif", kind)
    assert told in complain(tmp_path / "a.tif")


@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize("colour", [True, False])
def test_fewer_bits_than_16_are_told_by_the_values(tmp_path, bits, colour):
    values = (np.arange(256, dtype=np.uint16) << (bits - 8)).reshape(16, 16)
    values = np.stack([values] * 3, 2) if colour else values
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", values)[1])
    with collecting(Report()) as report:
        pixels = np.asarray(read_image(tmp_path / "a.png"))
    assert f"taken as {bits}-bit" in report.warnings[0]
    assert (pixels[..., 0] == np.arange(256).reshape(16, 16)).all()


def test_the_gamma_of_a_png_is_undone_but_not_beside_srgb(tmp_path):
    light = Image.new("RGBA", (4, 4), (55, 0, 255, 255))  # 55: sRGB's 128
    for srgb, red in ((False, 128), (True, 55)):
        chunks = PngInfo()
        if srgb:
            chunks.add(b"sRGB", b"\0")
        chunks.add(b"gAMA", struct.pack(">I", 100_000))
        light.save(tmp_path / "a.png", pnginfo=chunks)
        assert read_image(tmp_path / "a.png").getpixel((0, 0)) == (red, 0, 255)
