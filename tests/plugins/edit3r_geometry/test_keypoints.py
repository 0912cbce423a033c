"""Matches that stand still while others move: screens, frames, watermarks."""

import io

import numpy as np
import pytest
from edit3r_geometry.cameras import CalibratedImage
from edit3r_geometry.features import FeatureSettings, find_features
from edit3r_geometry.keypoints import MOVED, STILL, _still
from PIL import Image, ImageDraw, ImageOps
from skimage import data

from edit3r.contract.reporting import Report, collecting

LEFT, RIGHT = (
    Image.fromarray(one).resize((512, 345)) for one in data.stereo_motorcycle()[:2]
)
TEXT = "12:41   Instagram  LTE 87%   Liked by anna and 1,204 others"


def bars(photo):
    screen = Image.new("RGB", (photo.width, photo.height * 3 // 2), (20, 20, 20))
    screen.paste(photo, (0, photo.height // 4))
    draw = ImageDraw.Draw(screen)
    draw.text((20, 20), TEXT, fill="white")
    for i in range(5):
        draw.ellipse((30 + 90 * i, 460, 70 + 90 * i, 500), outline="white", width=3)
        draw.text((40 + 90 * i, 440), TEXT[5 * i : 5 * i + 9], fill="white")
    return screen


def light_bars(photo):
    return ImageOps.invert(bars(ImageOps.invert(photo)))


def watermark(photo):
    mark = Image.new("L", photo.size, 0)
    draw = ImageDraw.Draw(mark)
    for y in range(30, 340, 60):
        draw.text((20, y), TEXT, fill=150, font_size=22)
    return Image.composite(Image.new("RGB", photo.size, "white"), photo, mark)


def date_stamp(photo):
    stamped = photo.copy()
    ImageDraw.Draw(stamped).text((330, 310), "2024-05-17", fill="orange", font_size=28)
    ImageDraw.Draw(stamped).text((20, 310), "CAM 04 FRONT", fill="white", font_size=28)
    return stamped


def frame(photo):
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (58, 86, 3), np.uint8)
    pattern = np.kron(coarse, np.ones((6, 6, 1), np.uint8))
    framed = Image.fromarray(pattern[:345, :512])
    framed.paste(photo.resize((432, 285)), (40, 30))
    return framed


def dashboard(photo):
    """What moves along with the camera: the front of a car, a drone's leg."""
    rng = np.random.default_rng(1)
    part = Image.fromarray(rng.integers(0, 255, (20, 64, 3), np.uint8))
    moved = photo.copy()
    moved.paste(part.resize((512, 90)), (0, 255))
    return moved


def again_as_jpeg(photo):
    content = io.BytesIO()
    bars(photo).save(content, "JPEG", quality=75)
    return Image.open(content).convert("RGB")


SCREENS = [bars, light_bars, watermark, date_stamp, frame, dashboard, again_as_jpeg]


def found(*photos):
    lens = np.array([[500.0, 0, 256], [0, 500, 172], [0, 0, 1]])
    pixels = [np.asarray(photo, np.float32) / 255 for photo in photos]
    images = [CalibratedImage(one, lens) for one in pixels]
    with collecting(Report()) as report:
        features = find_features(images, FeatureSettings(matches="sift"))
    ways = {}
    for (a, b), pairs in features.indices.items():
        first, second = (features.keypoints[view].points for view in (a, b))
        moved = first[pairs[:, 0]] - second[pairs[:, 1]]
        ways[a, b] = np.linalg.norm(moved, axis=1)
    return ways, " ".join(report.warnings)


@pytest.mark.parametrize("screen", SCREENS)
def test_what_stands_still_is_left_out_and_said(screen):
    ways, told = found(screen(LEFT), screen(RIGHT))
    assert "screen" in told
    assert (ways[0, 1] < STILL).sum() == 0 and (ways[0, 1] > MOVED).sum() > 50


def test_each_pair_of_several_photos_is_looked_at():
    ways, told = found(bars(LEFT), bars(RIGHT), bars(LEFT.transpose(0)))
    assert "screen" in told and all((way < STILL).sum() == 0 for way in ways.values())


def black_bars(photo):
    return Image.fromarray(np.pad(np.asarray(photo), ((60, 60), (0, 0), (0, 0))))


def shifted(photo, by):
    return photo.transform(photo.size, Image.Transform.AFFINE, (1, 0, by, 0, 1, 0))


ORDINARY = {
    "the pair itself": (LEFT, RIGHT),
    "from one place": (LEFT, shifted(LEFT, 0.3)),
    "the same photo twice": (LEFT, LEFT),
    "a little turned": (LEFT, LEFT.rotate(4, resample=2)),
    "a little nearer": (LEFT, LEFT.resize((552, 372)).crop((20, 14, 532, 359))),
    "black bars without text": tuple(map(black_bars, (LEFT, RIGHT))),
}


@pytest.mark.parametrize("pair", ORDINARY.values(), ids=ORDINARY)
def test_ordinary_pairs_lose_nothing(pair):
    assert "screen" not in found(*pair)[1]


def test_what_is_far_away_and_hardly_moves_stays():
    """Points at every distance: some stand still, some move a little, many move far."""
    first = np.random.default_rng(0).uniform(50, 300, (300, 2))
    second = first + np.column_stack((np.linspace(0, 12, 300), np.zeros(300)))
    picture = CalibratedImage(np.zeros((345, 512, 3), np.float32), np.eye(3))
    assert not _still(first, second, picture, picture).any()
    second[15:100, 0] += 8  # a gap between what stands still and what moves
    assert _still(first, second, picture, picture).sum() == 15
