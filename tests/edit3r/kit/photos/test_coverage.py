"""Which photos of many, and which frames of a video, are used: few that show most of all."""

import warnings

import cv2
import numpy as np
import pytest

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos import coverage
from edit3r.kit.photos.coverage import (
    MIN_SHARED,
    choose_photos,
    covering,
    features_of,
    shared,
    take_frames,
)
from edit3r.kit.photos.images import load_photos
from edit3r.kit.photos.temporary import origin, temporary_photos

SIDE = 240


def wall(width=1200):
    """A long wall full of corners."""
    rng = np.random.default_rng(0)
    pixels = np.full((SIDE, width, 3), 120, np.uint8)
    for _ in range(1200):
        x, y, size = rng.integers(0, width), rng.integers(0, SIDE), rng.integers(4, 18)
        cv2.rectangle(
            pixels,
            (int(x), int(y)),
            (int(x + size), int(y + size)),
            rng.integers(0, 255, 3).tolist(),
            -1,
        )
    return pixels


def video(path, places, blurred=()):
    """A camera that looks at the wall from `places` [pixels], out of focus in some frames."""
    pixels = wall()
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter_fourcc(*"mp4v"), 12, (320, SIDE)
    )
    for number, x in enumerate(places):
        frame = np.ascontiguousarray(pixels[:, x : x + 320])
        writer.write(cv2.GaussianBlur(frame, (0, 0), 4) if number in blurred else frame)
    writer.release()
    return path


def test_views_n_takes_the_photos_that_differ(tmp_path):
    pixels, files = wall(), []
    for index, x in enumerate((0, 2, 4, 6, 8, 150, 300)):
        files.append(tmp_path / f"{index}.png")
        cv2.imwrite(str(files[-1]), pixels[:, x : x + 320])
    assert {file.name for file in choose_photos(files, 3)} > {
        "5.png",
        "6.png",
    } or choose_photos(files, 3)[1:] == files[5:]
    assert choose_photos(files, None) == files == choose_photos(files, 7)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert load_photos(tmp_path, size=64, most=3).views.count == 3


@pytest.fixture
def block():
    with temporary_photos():
        yield


def test_frames_last_as_long_as_the_block_around_and_need_one(tmp_path):
    clip = video(tmp_path / "clip.mp4", range(0, 480, 40))
    with temporary_photos():
        with temporary_photos():
            files = take_frames(clip, 2)
        assert all(file.is_file() for file in files)
        assert origin(files[0]).startswith(f"{clip}, frame ")
    assert not any(file.exists() for file in files)
    assert origin(files[0]) == str(files[0])
    with pytest.raises(RuntimeError, match="temporary_photos"):
        take_frames(clip, 2)


@pytest.mark.usefixtures("block")
def test_of_a_video_the_sharp_frames_are_taken(tmp_path):
    # of each stretch of two frames one
    blurred = {number for number in range(24) if number % 2}
    report = Report()
    with collecting(report):
        taken = take_frames(video(tmp_path / "clip.mp4", range(0, 480, 20), blurred), 4)
    numbers = [int(file.stem.split("_")[1]) for file in taken]
    assert len(taken) == 4 and numbers == sorted(numbers) and not blurred & set(numbers)
    said = report.notes["video.frames"]
    assert f"frames {', '.join(map(str, numbers))} are used" in said and "16 s" in said


@pytest.mark.slow
@pytest.mark.usefixtures("block")
def test_frames_in_which_nothing_moved_are_left_out(tmp_path):
    with pytest.warns(UserWarning, match="nothing has moved"):
        taken = take_frames(
            video(tmp_path / "clip.mp4", [0] * 20 + [60] * 20 + [120] * 20), 8
        )
    assert len(taken) == 3


def test_a_video_from_one_place_is_an_error(tmp_path):
    with pytest.raises(
        InputError, match=r"clip\.mp4: shows the scene from one place only"
    ):
        take_frames(video(tmp_path / "clip.mp4", [0] * 12))


@pytest.mark.parametrize(
    "content", [b"", b"no video", b"\0\0\0\x18ftypmp42" + bytes(100)]
)
def test_what_is_no_video_is_one_sentence(tmp_path, content):
    (tmp_path / "clip.mp4").write_bytes(content)
    with pytest.raises(InputError, match=r"clip\.mp4: not a video"):
        load_photos(tmp_path / "clip.mp4")


@pytest.mark.slow
def test_a_video_is_loaded_as_its_frames_and_the_record_says_which(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = load_photos(video(tmp_path / "clip.mp4", range(0, 480, 20)), size=64)
    assert loaded.views.count == 8
    for photo in loaded.photos:
        assert (
            photo.file
            == f"{tmp_path / 'clip.mp4'}, frame {int(photo.name.removeprefix('clip_'))}"
        )


@pytest.mark.parametrize(
    ("places", "warned"), [([0] * 6 + [60, 120, 180], True), (range(0, 480, 40), False)]
)
def test_frames_in_which_nothing_moved_are_said_to_be_left_out(
    block, tmp_path, places, warned
):
    clip = video(tmp_path / "clip.mp4", places)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        take_frames(clip, 8)
    assert (
        any("are left out, nothing has moved" in str(one.message) for one in said)
        == warned
    )


def test_a_video_without_end_is_told_before_any_frame_is_kept(tmp_path, monkeypatch):
    clip = video(tmp_path / "clip.mp4", range(0, 480, 40))
    monkeypatch.setattr(coverage, "MAX_FRAMES", 6)
    with pytest.raises(InputError, match="6 frames or more, so it is damaged or too"):
        take_frames(clip)


def test_photos_are_chosen_that_cover_what_all_show():
    """Four photos in a row, one of them taken five times: by counting, copies of that one would be
    used.
    """
    place = np.array([0, 0.02, 0.01, 0.03, 0.04, 1, 2, 3])
    common = np.maximum(0, 1 - abs(place[:, None] - place) / 1.5)
    chosen = covering(common, 4)
    assert len(chosen) == 4 and {5, 6, 7} < set(chosen)


def test_photos_of_other_things_share_nothing_though_each_feature_has_a_nearest():
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 255, (240, 240, 3), dtype=np.uint8)
    blocks = rng.integers(0, 255, (20, 20, 3), dtype=np.uint8)
    wall = blocks.repeat(12, 0).repeat(12, 1)
    here, elsewhere = features_of(wall), features_of(noise)
    assert shared([here, here])[0, 1] > 0.9
    assert shared([here, elsewhere])[0, 1] < MIN_SHARED


def test_a_photo_that_shares_nothing_is_not_chosen_before_those_that_do():
    place = np.array([0, 1, 2, 90])
    assert covering(np.maximum(0, 1 - abs(place[:, None] - place) / 1.5), 3) == [
        0,
        1,
        2,
    ]


def test_of_two_photos_the_one_that_shows_less_counts_in_whichever_order():
    rng = np.random.default_rng(1)
    blocks = rng.integers(0, 255, (8, 8, 3), dtype=np.uint8)
    wall = blocks.repeat(40, 0).repeat(40, 1)
    part = np.full_like(wall, 128)
    part[:160, :160] = wall[:160, :160]
    few, many = features_of(part), features_of(wall)
    assert len(few.points) < 0.6 * len(many.points)
    orders = [shared(pair)[0, 1] for pair in ((few, many), (many, few))]
    assert orders[0] == orders[1] > 0.6
