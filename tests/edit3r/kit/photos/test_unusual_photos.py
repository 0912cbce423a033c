"""Photos: very large, of all around, for bright screens, damaged inside; and turned TIFFs."""

import io
import struct
import zlib

import numpy as np
import pytest
import torch
from PIL import Image
from skimage import data

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos import decode as module
from edit3r.kit.photos.decode import decode, image_size
from edit3r.kit.photos.images import load_photos

PHOTO = Image.fromarray(data.stereo_motorcycle()[0])


def coded(image=PHOTO, **options):
    content = io.BytesIO()
    image.save(content, "JPEG", quality=90, **options)
    return content.getvalue()


def said(call, *args):
    with collecting(Report()) as report:
        answer = call(*args)
    return answer, " ".join(report.warnings)


# Large


@pytest.fixture
def small_limit(monkeypatch):
    """Photos of 300,000 pixels count as very large."""
    monkeypatch.setattr(module, "WHOLE_PIXELS", 300_000)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("kind", ["JPEG", "MPO", "progressive", "grey", "CMYK"])
def test_a_large_jpeg_is_decoded_in_part_and_looks_the_same(
    tmp_path, monkeypatch, kind, orientation
):
    exif = Image.Exif()
    exif[274] = orientation
    exif.get_ifd(0x8769)[0xA405] = 26
    image = PHOTO.convert({"grey": "L", "CMYK": "CMYK"}.get(kind, "RGB"))
    more = {"progressive": True} if kind == "progressive" else {}
    form = "MPO" if kind == "MPO" else "JPEG"
    image.save(tmp_path / "a.jpg", form, quality=95, exif=exif, **more)
    whole = load_photos([tmp_path / "a.jpg"], size=128)
    monkeypatch.setattr(module, "WHOLE_PIXELS", 300_000)
    part = load_photos([tmp_path / "a.jpg"], size=128)
    assert max(decode(tmp_path / "a.jpg", 256).pixels.size) == 371
    assert part.photos == whole.photos
    torch.testing.assert_close(part.views.intrinsics, whole.views.intrinsics)
    error = (part.views.images - whole.views.images).square().mean()
    assert -10 * error.log10() > 36


def test_without_a_size_all_of_it_is_decoded(tmp_path, small_limit):
    (tmp_path / "a.jpg").write_bytes(coded())
    assert decode(tmp_path / "a.jpg").pixels.size == PHOTO.size


@pytest.mark.slow
def test_200_megapixels_are_read(tmp_path):
    PHOTO.resize((60, 80)).resize((16320, 12240)).save(tmp_path / "a.jpg")
    loaded = load_photos([tmp_path / "a.jpg"])
    assert loaded.photos[0].size == (12240, 16320)
    assert loaded.views.images.shape[-2:] == (384, 512)


def header_of(width, height, content):
    """The JPEG with another size in its header."""
    at = content.index(b"\xff\xc0") + 5
    return content[:at] + struct.pack(">HH", height, width) + content[at + 4 :]


@pytest.mark.parametrize("size", [(20000, 20000), (65000, 65000)])
def test_what_is_larger_is_refused(tmp_path, size):
    (tmp_path / "a.jpg").write_bytes(header_of(*size, coded()))
    with pytest.raises(InputError, match="JPEGs of at most 268 megapixels"):
        decode(tmp_path / "a.jpg")


@pytest.mark.parametrize("size", [(16384, 3), (3, 9000), (800, 39)])
def test_a_strip_among_photos_is_called_a_strip(tmp_path, size):
    Image.new("RGB", size).save(tmp_path / "a.png")
    PHOTO.save(tmp_path / "b.png")
    with pytest.raises(InputError, match=r"a\.png: .* a strip and no photo"):
        load_photos([tmp_path / "a.png", tmp_path / "b.png"])


# All around

XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description {0}>{1}</rdf:Description>'
    "</rdf:RDF></x:xmpmeta>"
)
SPHERES = {
    "attribute": ('GPano:ProjectionType="equirectangular"', ""),
    "apostrophes": ("GPano:ProjectionType = 'equirectangular'", ""),
    "element": ("", "<GPano:ProjectionType>equirectangular</GPano:ProjectionType>"),
    "capitals": ("", "<GPano:ProjectionType>Equirectangular</GPano:ProjectionType>"),
    "cylinder": ('GPano:ProjectionType="cylindrical"', ""),
}


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tif"])
@pytest.mark.parametrize("parts", SPHERES.values(), ids=SPHERES)
def test_a_picture_all_around_is_called_so(tmp_path, parts, suffix):
    text = XMP.format(*parts)
    more = {"xmp": text.encode()}
    if suffix == "png":
        from PIL.PngImagePlugin import PngInfo

        info = PngInfo()
        info.add_itxt("XML:com.adobe.xmp", text)
        more = {"pnginfo": info}
    if suffix == "tif":
        more = {"tiffinfo": {700: text.encode()}}
    PHOTO.resize((60, 30)).save(tmp_path / f"a.{suffix}", **more)
    with pytest.raises(InputError, match="a picture of all around"):
        decode(tmp_path / f"a.{suffix}")


def test_xmp_of_an_ordinary_photo_is_passed_over(tmp_path):
    PHOTO.resize((60, 30)).save(
        tmp_path / "a.jpg", xmp=XMP.format("", "GPano").encode()
    )
    assert decode(tmp_path / "a.jpg").pixels.size == (60, 30)


# For bright screens


def png_of(values, *coding):
    """A PNG of 8 bits in this coding (H.273: primaries, transfer)."""
    content = io.BytesIO()
    Image.fromarray(values).save(content, "PNG")
    content = content.getvalue()
    body = b"cICP" + bytes([*coding, 0, 1])
    chunk = struct.pack(">I", 4) + body + struct.pack(">I", zlib.crc32(body))
    return content[:33] + chunk + content[33:]


def grey(level):
    return np.full((4, 4, 3), level, np.uint8)


@pytest.mark.parametrize("transfer", [1, 13, 16, 18])
def test_a_picture_for_bright_screens_is_said_to_be_dull(tmp_path, transfer):
    """PQ (16) and HLG (18) of H.273; 13 is sRGB, 1 that of television."""
    (tmp_path / "a.png").write_bytes(png_of(grey(100), 9, transfer))
    image, told = said(decode, tmp_path / "a.png")
    assert np.asarray(image.pixels).tolist() == grey(100).tolist()
    assert ("bright screens" in told) == (transfer in (16, 18))


@pytest.mark.parametrize("kind", ["heic", "avif"])
def test_heic_and_avif_say_it_in_their_own_way(kind):
    """In their box colr."""
    head = struct.pack(">I4s4s", 24, b"ftyp", kind.encode()) + bytes(20)
    box = struct.pack(">I4s4sHHHB", 19, b"colr", b"nclx", 9, 16, 9, 128)
    _, told = said(module._tell_bright, io.BytesIO(head + box + bytes(100)), "a")
    assert "bright screens" in told


# Damaged inside


def changed(content, at, put, drop=0):
    place = round(len(content) * at)
    return content[:place] + put + content[place + len(put) + drop :]


NOISE = np.random.default_rng(0).integers(0, 255, 3000, np.uint8).tobytes()
DAMAGED = {
    "zeros": changed(coded(), 0.5, bytes(4096)),
    "noise": changed(coded(), 0.5, NOISE),
    "early": changed(coded(), 0.2, NOISE),
    "late": changed(coded(), 0.8, NOISE),
    "a part missing": changed(coded(), 0.5, b"", 3000),
    "cut off, with an end": coded()[: len(coded()) * 2 // 3] + b"\xff\xd9",
    "progressive, zeros": changed(coded(progressive=True), 0.5, bytes(4096)),
    "progressive, noise": changed(coded(progressive=True), 0.5, NOISE),
    "grey": changed(coded(PHOTO.convert("L")), 0.5, NOISE),
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_a_jpeg_damaged_inside_is_named(tmp_path, content, capfd):
    (tmp_path / "a.jpg").write_bytes(content)
    _, told = said(decode, tmp_path / "a.jpg")
    assert "a.jpg: damaged inside" in told
    assert "Corrupt" not in capfd.readouterr().err


@pytest.mark.parametrize(
    "content",
    [
        coded(),
        coded(progressive=True),
        coded() + bytes(5000),
        coded()[:-2] + b"\x00\x00\xff\xd9",
    ],
    ids=["whole", "progressive", "something behind", "two bytes too many"],
)
def test_a_whole_jpeg_is_not(tmp_path, content):
    (tmp_path / "a.jpg").write_bytes(content)
    assert said(decode, tmp_path / "a.jpg")[1] == ""


# Turned TIFFs


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("mode", ["L", "P", "I;16", "F", "1", "RGB"])
def test_a_turned_tiff_is_upright_in_every_mode(tmp_path, mode, orientation):
    values = (np.indices((6, 9)).sum(0) % 2 * 200).astype(np.uint8)
    values[0, :2] = 255 if mode == "1" else 90
    image = Image.fromarray(values)
    stored = {
        "I;16": lambda: Image.fromarray(values.astype(np.uint16) * 257),
        "F": lambda: Image.fromarray(values.astype(np.float32) / 255),
        "P": lambda: Image.merge("RGB", [image] * 3).quantize(4, dither=0),
    }.get(mode, lambda: image.convert(mode, dither=0))()
    exif = Image.Exif()
    exif[274] = orientation
    stored.save(tmp_path / "a.tif", exif=exif)
    stored.save(tmp_path / "plain.tif")
    plain = np.asarray(decode(tmp_path / "plain.tif").pixels)
    turns = {1: plain, 2: plain[:, ::-1], 3: plain[::-1, ::-1], 4: plain[::-1]}
    across = plain.transpose(1, 0, 2)
    turns |= {5: across, 6: across[:, ::-1], 7: across[::-1, ::-1], 8: across[::-1]}
    found = np.asarray(decode(tmp_path / "a.tif").pixels)
    np.testing.assert_array_equal(found, turns[orientation])
    assert image_size(tmp_path / "a.tif") == found.shape[:2]


def test_two_pictures_side_by_side_are_refused_whatever_they_are_called(tmp_path):
    picture = Image.new("RGB", (40, 20))
    picture.save(tmp_path / "a.jps", "JPEG")
    picture.save(tmp_path / "plain.jpg")
    content = (tmp_path / "plain.jpg").read_bytes()
    marker = b"\xff\xe3\x00\x0c_JPSJPS_\x00\x00"
    (tmp_path / "b.jpg").write_bytes(content[:2] + marker + content[2:])
    for name in ("a.jps", "b.jpg"):
        with pytest.raises(InputError, match="cut it in two"):
            decode(tmp_path / name)


@pytest.mark.parametrize(("second", "said"), [((40, 20), 1), ((20, 10), 0)])
def test_the_second_picture_of_a_stereo_camera_is_named_and_a_preview_is_not(
    tmp_path, second, said
):
    left, other = Image.new("RGB", (40, 20), "red"), Image.new("RGB", second, "blue")
    left.save(tmp_path / "a.mpo", "MPO", save_all=True, append_images=[other])
    with collecting(Report()) as report:
        red, _, blue = decode(tmp_path / "a.mpo").pixels.getpixel((5, 5))
    assert red > 200 and blue < 50
    assert ["two pictures of one size" in one for one in report.warnings] == [
        True
    ] * said


def test_a_damaged_second_picture_does_not_cost_the_first(tmp_path):
    left = Image.new("RGB", (40, 20), "red")
    left.save(tmp_path / "a.mpo", "MPO", save_all=True, append_images=[left])
    content = (tmp_path / "a.mpo").read_bytes()
    second = content.rindex(b"\xff\xd8")
    (tmp_path / "a.mpo").write_bytes(content[:second] + bytes(len(content) - second))
    assert decode(tmp_path / "a.mpo").pixels.getpixel((5, 5))[0] > 200
