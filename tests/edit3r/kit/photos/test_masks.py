import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos.images import load_photos
from edit3r.kit.photos.masks import load_masks


@pytest.fixture
def photos(tmp_path):
    """Two photos, 400x300 and 300x400, which meet as 300x300 views."""
    noise = np.random.default_rng(0).integers(0, 255, (400, 400, 3), dtype=np.uint8)
    Image.fromarray(noise[:300]).save(tmp_path / "a.png")
    Image.fromarray(noise[:, :300]).save(tmp_path / "b.png")
    return load_photos([tmp_path / "a.png", tmp_path / "b.png"], fov=60)


def mask(path, values):
    Image.fromarray(values.astype(np.uint8)).save(path)
    return path


def test_mask_is_cropped_as_its_photo_was(tmp_path, photos):
    left = np.zeros((300, 400))
    left[:, :150] = 255
    masks = load_masks(
        [
            mask(tmp_path / "m.png", left),
            mask(tmp_path / "n.png", np.full((400, 300), 255)),
        ],
        photos,
    )
    assert masks.shape == (1, 2, 300, 300) and masks.dtype == torch.float32
    assert (masks[0, 0, :, :100] == 1).all() and (masks[0, 0, :, 100:] == 0).all()
    assert (masks[0, 1] == 1).all()


def test_mask_of_another_resolution_is_scaled_and_stays_exact_away_from_the_edge(
    tmp_path, photos
):
    half = np.zeros((30, 40))
    half[15:] = 255
    masks = load_masks(
        [mask(tmp_path / "m.png", half)] * 2, photos_of_one_shape(tmp_path)
    )
    assert (masks[0, 0, :135] == 0).all() and (masks[0, 0, 165:] == 1).all()


def photos_of_one_shape(tmp_path):
    return load_photos([tmp_path / "a.png", tmp_path / "a.png"], fov=60)


def test_mask_of_the_views_own_size_is_taken_as_it_is(tmp_path, photos):
    grey = np.full((300, 300), 51)
    masks = load_masks([mask(tmp_path / "m.png", grey)] * 2, photos)
    torch.testing.assert_close(masks, torch.full((1, 2, 300, 300), 0.2))


def test_truth_values_mean_black_and_white(tmp_path, photos):
    ones = np.ones((300, 300))
    ones[0] = 0
    with collecting(Report()) as report:
        masks = load_masks([mask(tmp_path / "m.png", ones)] * 2, photos)
    assert masks[0, 0, 5, 5] == 1 and "only the values 0 and 1" in report.warnings[0]


def test_black_mask_is_warned_of(tmp_path, photos):
    with collecting(Report()) as report:
        load_masks([mask(tmp_path / "m.png", np.zeros((300, 300)))] * 2, photos)
    assert "all black" in report.warnings[0]


def test_wrong_number_and_wrong_shape_are_errors(tmp_path, photos):
    path = mask(tmp_path / "m.png", np.full((100, 200), 255))
    with pytest.raises(InputError, match=r"one mask per photo \(2\), got 1"):
        load_masks([path], photos)
    with pytest.raises(
        InputError,
        match=r"m.png: this mask is 200x100; expected the shape of its photo \(400x300\)",
    ):
        load_masks([path, path], photos)


def test_transparent_mask_is_an_error(tmp_path, photos):
    Image.new("RGBA", (300, 300), (255, 255, 255, 0)).save(tmp_path / "m.png")
    with pytest.raises(InputError, match="transparent"):
        load_masks([tmp_path / "m.png"] * 2, photos)
