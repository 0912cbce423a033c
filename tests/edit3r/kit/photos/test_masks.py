import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos.images import load_photos
from edit3r.kit.photos.masks import load_masks, read_mask


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


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
@pytest.mark.parametrize("colour", ["black", "white"])
def test_alpha_is_the_mask_where_all_that_is_opaque_has_one_colour(
    tmp_path, photos, mode, colour
):
    alpha = np.zeros((300, 400), np.uint8)
    alpha[100:200, 100:300], alpha[100:200, 300:] = 255, 51
    image = Image.new("RGB", (400, 300), colour).convert(mode)
    image.putalpha(Image.fromarray(alpha))
    image.save(tmp_path / "m.png")
    with collecting(Report()) as report:
        found = read_mask(tmp_path / "m.png", photos.photos[0].frame)
    assert found[150, 100] == 1 and found[150, 299] == pytest.approx(0.2)
    assert found[:90].max() == 0 and "selection.alpha" in report.notes


def test_what_a_faint_layer_covers_is_white(tmp_path, photos):
    """As annotation tools draw their colours over a photo."""
    alpha = np.zeros((300, 400), np.uint8)
    alpha[100:200, 100:300] = 100
    image = Image.new("RGBA", (400, 300), "red")
    image.putalpha(Image.fromarray(alpha))
    image.save(tmp_path / "m.png")
    found = read_mask(tmp_path / "m.png", photos.photos[0].frame)
    assert found[150, 150] == 1 and found[:90].max() == 0


@pytest.mark.parametrize("most", [1, 255])
def test_floats_are_greys(tmp_path, photos, most):
    values = np.zeros((300, 400), np.float32)
    values[100:200], values[200:] = most, 0.2 * most
    Image.fromarray(values).save(tmp_path / "m.tif")
    found = read_mask(tmp_path / "m.tif", photos.photos[0].frame)
    assert found[150].min() == 1 and found[250].mean() == pytest.approx(0.2)


def test_a_picture_with_holes_is_no_mask(tmp_path, photos):
    image = Image.open(tmp_path / "a.png").convert("RGBA")
    image.putalpha(outlined("index").convert("L"))
    image.putpixel((0, 0), (9, 9, 9, 255))
    image.putpixel((1, 0), (99, 9, 9, 255))
    image.save(tmp_path / "m.png")
    Image.new("RGBA", (300, 300), (255, 255, 255, 0)).save(tmp_path / "n.png")
    Image.new("RGBA", (300, 300), (255, 0, 0, 90)).save(tmp_path / "o.png")
    for name in ("m.png", "n.png", "o.png"):
        with pytest.raises(InputError, match="transparent"):
            read_mask(tmp_path / name, photos.photos[0].frame)


def outlined(kind):
    """The same square as annotation tools write it."""
    inside = np.zeros((300, 400), np.uint8)
    inside[100:200, 100:300] = 1
    if kind == "palette":
        image = Image.fromarray(inside, "P")
        image.putpalette([0, 0, 0, 128, 0, 0] + [0] * 762)
        return image
    colours = {
        "red": (250, 50, 83),
        "green": (0, 255, 0),
        "small green": (0, 255, 0),
        "index": (2, 2, 2),
        "large index": (38, 38, 38),
        "index and void": (15, 15, 15),
        "colour and void": (0, 128, 0),
    }
    pixels = inside[..., None] * np.array(colours[kind], np.uint8)
    if "void" in kind:  # as VOC draws it around things, and leaves out others
        pixels[200:204] = pixels[:60] = (
            255 if kind.startswith("index") else (224, 224, 192)
        )
    return Image.fromarray(pixels)


@pytest.mark.parametrize(
    "kind, suffix",
    [
        *((kind, ".png") for kind in ("palette", "red", "green", "index")),
        *((kind, ".gif") for kind in ("palette", "red")),
        *((kind, ".webp") for kind in ("red",)),
        *((kind, ".jpg") for kind in ("palette", "red", "green", "small green")),
        *((f"{kind} and void", ".png") for kind in ("index", "colour")),
        ("large index", ".png"),
    ],
)
def test_one_label_of_any_colour_is_white(tmp_path, photos, kind, suffix):
    path = tmp_path / f"m{suffix}"
    image = outlined(kind)
    image = image.convert("RGB") if suffix in (".jpg", ".webp") else image
    if kind.startswith("small"):  # JPEG's blurred edges take more of it
        image = image.resize((100, 75), Image.Resampling.NEAREST)
    image.save(path)
    with pytest.warns(UserWarning, match="label image.*taken as white"):
        found = read_mask(path, photos.photos[0].frame)
    assert found[110:190, 60:240].min() > 0.9 and found[:90].max() < 0.05


def test_several_labels_are_listed(tmp_path, photos):
    for image, listed in (
        (np.array([0, 1, 3], np.uint8), "1 and 3"),
        (np.array([[0, 0, 0], [128, 0, 0], [0, 128, 0]], np.uint8), "128,0,0"),
    ):
        Image.fromarray(image[np.arange(400) % 3][None].repeat(300, 0)).save(
            tmp_path / "m.png"
        )
        with pytest.raises(InputError, match=f"holds .*{listed}.*one thing"):
            read_mask(tmp_path / "m.png", photos.photos[0].frame)


def test_greys_stay_as_they_are(tmp_path, photos):
    path = mask(tmp_path / "m.png", np.full((300, 400), 100))
    assert read_mask(path, photos.photos[0].frame).unique().tolist() == [
        pytest.approx(100 / 255)
    ]
