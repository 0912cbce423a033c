"""Photos that a program holds in memory, and what is no photo."""

import io
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from skimage import data

import edit3r
from edit3r.contract.errors import InputError
from edit3r.kit.photos.images import load_photos, load_views

LEFT, RIGHT = (one[:60, :80] for one in data.stereo_motorcycle()[:2])


def tensor(array):
    return torch.from_numpy(np.ascontiguousarray(array)).permute(2, 0, 1)


def file_of(array, form="PNG"):
    content = io.BytesIO()
    Image.fromarray(array).save(content, form)
    content.seek(0)
    return content


PAIR = [LEFT, RIGHT]
TAKEN = {
    "arrays of bytes": PAIR,
    "a tuple": tuple(PAIR),
    "a generator": lambda: (one for one in PAIR),
    "a stack": np.stack(PAIR),
    "floats": [one / 255 for one in PAIR],
    "float32": [np.float32(one / 255) for one in PAIR],
    "float16": [np.float16(one / 255) for one in PAIR],
    "16 bits": [one.astype(np.uint16) * 257 for one in PAIR],
    "int64": [one.astype(np.int64) for one in PAIR],
    "channels first": [one.transpose(2, 0, 1) for one in PAIR],
    "tensors": [tensor(one) for one in PAIR],
    "tensors of floats": [tensor(one) / 255 for one in PAIR],
    "a stack of tensors": torch.stack([tensor(one) for one in PAIR]) / 255,
    "tensors, channels last": [torch.from_numpy(one.copy()) for one in PAIR],
    "tensors with gradients": [(tensor(one) / 255).requires_grad_() for one in PAIR],
    "PIL": [Image.fromarray(one) for one in PAIR],
    "PIL of files": lambda: [Image.open(file_of(one)) for one in PAIR],
    "with alpha": [np.dstack((one, np.full((60, 80), 255, np.uint8))) for one in PAIR],
    "not contiguous": [np.asfortranarray(one) for one in PAIR],
    "bytes of files": [file_of(one).getvalue() for one in PAIR],
    "open files": lambda: [file_of(one) for one in PAIR],
    "of several kinds": [LEFT, Image.fromarray(RIGHT)],
}


@pytest.mark.parametrize("photos", TAKEN.values(), ids=TAKEN)
def test_pictures_in_memory_are_read_as_files_are(photos):
    views = load_views(photos() if callable(photos) else photos)
    expected = torch.stack([tensor(one) for one in PAIR])[None] / 255
    torch.testing.assert_close(views.images, expected, atol=2.1 / 255, rtol=0)
    assert views.names == ("photo-1", "photo-2")


@pytest.mark.parametrize(
    "grey",
    [
        LEFT[..., 0],
        LEFT[..., :1],
        torch.from_numpy(LEFT[..., 0].copy()),
        Image.fromarray(LEFT[..., 0]),
    ],
)
def test_grey_is_a_picture_too(grey):
    images = load_views([grey, grey]).images
    assert (images[0, 0, 0] == images[0, 0, 2]).all()


def test_pictures_of_several_sizes_share_one():
    loaded = load_photos([LEFT, RIGHT[:48, :64], Image.fromarray(LEFT[:50])], size=40)
    assert loaded.views.images.shape[:2] == (1, 3)
    assert [photo.size for photo in loaded.photos] == [(60, 80), (48, 64), (50, 80)]


def test_the_lens_and_the_turn_of_a_pil_image_are_read(tmp_path):
    exif = Image.Exif()
    exif[274] = 6
    exif.get_ifd(0x8769)[0xA405] = 26
    Image.fromarray(LEFT).save(tmp_path / "a.jpg", exif=exif)
    held, file = (
        load_photos([one])
        for one in (Image.open(tmp_path / "a.jpg"), tmp_path / "a.jpg")
    )
    assert held.photos[0].size == file.photos[0].size == (80, 60)
    assert held.photos[0].focal == file.photos[0].focal


@pytest.mark.parametrize(
    ("photos", "told"),
    [
        ([LEFT, None], "number 2 is nothing"),
        ([LEFT, 3], "number 2 is int"),
        (5, "got int, expected files, arrays"),
        ([LEFT.astype(float)], "; divide by 255"),
        ([LEFT / 255 - 0.5], "bring them to"),
        ([np.full((8, 8, 3), np.nan)], "not finite"),
        ([np.zeros((5, 5, 7))], r"shape \[5, 5, 7\]"),
        ([np.zeros((0, 5, 3))], r"shape \[0, 5, 3\]"),
        ([np.zeros(9)], r"shape \[9\]"),
        ([np.zeros((8, 8, 3), complex)], "values of complex"),
        ([b"no picture"], "not an image that can be read"),
        (["https://example.org/a.jpg"], "web address; download"),
        (["s3://bucket/a.jpg"], "web address"),
        ([Path("http://example.org/a.jpg")], "web address"),
        (["www.example.org/a.jpg"], "web address"),
    ],
)
def test_what_is_no_picture_is_told_with_what_to_do(photos, told):
    for call in (load_views, partial(edit3r.run, editor="none")):
        with pytest.raises(InputError, match=told):
            call(photos)


@pytest.mark.parametrize(
    "name", ["a.zip", "a.tar.gz", "a.7z", "a.rar", "A.ZIP", "a.tgz"]
)
def test_an_archive_is_to_be_unpacked(tmp_path, name):
    (tmp_path / name).write_bytes(b"PK")
    with pytest.raises(InputError, match="an archive; unpack it"):
        load_views([tmp_path / name])


def test_a_folder_that_looks_like_an_address_is_a_folder(tmp_path, monkeypatch):
    (tmp_path / "www.site").mkdir()
    Image.fromarray(LEFT).save(tmp_path / "www.site/a.png")
    monkeypatch.chdir(tmp_path)
    assert load_views("www.site").count == 1
