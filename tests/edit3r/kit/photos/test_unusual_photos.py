"""Photos: very large, of all around; and turned TIFFs."""

import io
import struct

import numpy as np
import pytest
import torch
from PIL import Image
from skimage import data

from edit3r.contract.errors import InputError
from edit3r.kit.photos import decode as module
from edit3r.kit.photos.decode import decode, image_size
from edit3r.kit.photos.images import load_photos

PHOTO = Image.fromarray(data.stereo_motorcycle()[0])


def coded(image=PHOTO, **options):
    content = io.BytesIO()
    image.save(content, "JPEG", quality=90, **options)
    return content.getvalue()


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
