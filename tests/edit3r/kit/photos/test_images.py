import hashlib
import json
import math
import os

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.lens import Lens
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos.images import (
    evenly,
    find_photos,
    load_photos,
    load_views,
    read_photos,
    save_image,
)


def photo(path, size=(40, 30), seed=0, focal_35mm=None):
    """A photo of noise; `size` is (width, height)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "test"  # Pillow drops EXIF data that hold nothing else
    if focal_35mm is not None:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = (
            focal_35mm
        )
    noise = np.random.default_rng(seed).integers(
        0, 255, (size[1], size[0], 3), dtype=np.uint8
    )
    Image.fromarray(noise).save(path, exif=exif)
    return path


def camera_file(path, *cameras):
    entries = [
        {
            "file": file,
            "width": w,
            "height": h,
            "K": [[f, 0, cx], [0, f, cy], [0, 0, 1]],
            "c2w": None,
        }
        for file, w, h, f, cx, cy in cameras
    ]
    path.write_text(json.dumps(entries))
    return path


def test_views_hold_the_photos_in_the_order_given(tmp_path):
    paths = [
        photo(tmp_path / name, seed=i) for i, name in enumerate(("b.png", "a.png"))
    ]
    views = edit3r.load_views([str(path) for path in paths])
    assert (
        views.images.shape == (1, 2, 3, 30, 40) and views.images.dtype == torch.float32
    )
    assert views.intrinsics.dtype == torch.float32
    assert views.names == ("b", "a")
    expected = np.asarray(Image.open(paths[1])).astype(np.float32) / 255
    torch.testing.assert_close(
        views.images[0, 1], torch.from_numpy(expected).permute(2, 0, 1), rtol=0, atol=0
    )


def test_folder_comes_in_natural_order_without_what_is_not_a_picture(tmp_path):
    for name in (
        "img10.png",
        "img2.JPG",
        "img1.png",
        "._img3.jpg",
        "notes.txt",
        "sub/img4.png",
    ):
        photo(tmp_path / name.replace(".txt", ".png"))
    (tmp_path / "notes.png").rename(tmp_path / "notes.txt")
    assert [path.name for path in find_photos(tmp_path)] == [
        "img1.png",
        "img2.JPG",
        "img10.png",
    ]


def test_scene_folder_stands_for_its_images_folder(tmp_path):
    photo(tmp_path / "images" / "1.png")
    assert [path.name for path in find_photos([tmp_path])] == ["1.png"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a system without pipes")
def test_a_pipe_where_a_photo_is_expected_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.jpg")
    with pytest.raises(InputError, match=r"pipe\.jpg: not a regular file"):
        find_photos([tmp_path / "pipe.jpg"])


def test_an_empty_folder_tells_where_photos_are_two_folders_down(tmp_path):
    for path in ("front/cam/1.png", "back/images/2.png"):
        photo(tmp_path / path)
    with pytest.raises(InputError, match=r"but in .*back.images, .*front.cam: give"):
        find_photos([tmp_path])


def test_a_wildcard_in_a_folder_whose_name_has_brackets_is_expanded(tmp_path):
    photo(tmp_path / "holiday [2024]" / "1.png")
    assert find_photos([tmp_path / "holiday [2024]" / "*.png"])


def test_no_photos_empty_folder_and_missing_path_are_errors(tmp_path):
    with pytest.raises(InputError, match="No photos given"):
        load_views([])
    with pytest.raises(InputError, match="no images in this folder"):
        load_views(tmp_path)
    with pytest.raises(InputError, match=r"none\.jpg: no such file"):
        load_views([tmp_path / "none.jpg"])


def test_photos_of_different_sizes_and_shapes_share_one_size_and_the_loss_is_said(
    tmp_path,
):
    paths = [
        photo(tmp_path / "a.png", (400, 300)),
        photo(tmp_path / "b.png", (300, 400), seed=1),
    ]
    with collecting(Report()) as report:
        loaded = load_photos(paths, fov=90)
    assert loaded.views.image_size == (300, 300)
    assert [photo.size for photo in loaded.photos] == [(300, 400), (400, 300)]
    assert any("a.png: 25% is cropped away" in warning for warning in report.warnings)
    # Square pixels stay square, and a quarter off either side is an eighth of a turn less on each.
    torch.testing.assert_close(
        loaded.views.intrinsics[0, 0, 0, 0], torch.tensor(0.5 * 400 / 300)
    )
    torch.testing.assert_close(
        loaded.views.intrinsics[0, 0, 1, 1], torch.tensor(0.5 * 400 / 300)
    )


@pytest.mark.parametrize("size", [(1, 1), (30, 590), (3000, 160)])
def test_extreme_shapes_are_read(tmp_path, size):
    views = load_views(
        [photo(tmp_path / "a.png", size), photo(tmp_path / "b.png", size, seed=1)]
    )
    assert max(views.image_size) == min(512, max(size)) and min(views.image_size) >= 1


def test_size_bounds_the_longer_side_and_none_keeps_it(tmp_path):
    path = photo(tmp_path / "a.png", (741, 500))
    assert load_views(path).image_size == (345, 512)
    assert load_views(path, size=100).image_size == (67, 100)
    assert load_views(path, size=None).image_size == (500, 741)


def test_record_names_file_hash_and_focal(tmp_path):
    path = photo(tmp_path / "a.png", (400, 300))
    record = load_photos(path, fov=90).photos[0]
    assert (
        record.file == str(path)
        and record.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    )
    assert (
        record.focal == pytest.approx((200, 200))
        and record.intrinsics_source == "--fov 90"
    )


@pytest.mark.parametrize("told_by", ["EXIF", "camera file", "camera file with k1"])
def test_a_photo_of_the_others_size_was_taken_by_their_lens(tmp_path, told_by):
    """One that a messenger sent on, or that COLMAP could not place."""
    focal = 50 if told_by == "EXIF" else None
    paths = [
        photo(tmp_path / "a.png", (400, 300), seed=0, focal_35mm=focal),
        photo(tmp_path / "b.png", (400, 300), seed=1),
        photo(tmp_path / "small.png", (40, 30), seed=2),
    ]
    if told_by != "EXIF":
        frame = {"file_path": "a.png", "fl_x": 577.8, "w": 400, "h": 300}
        frame |= {"k1": 0.05} if told_by.endswith("k1") else {}
        content = {"frames": [frame | {"transform_matrix": torch.eye(4).tolist()}]}
        (tmp_path / "transforms.json").write_text(json.dumps(content))
    loaded = load_photos(paths)
    first, second, small = loaded.photos
    assert second.focal == pytest.approx(first.focal)
    assert second.frame == first.frame
    assert second.intrinsics_source.endswith("of other photos of its size")
    assert loaded.views.assumed == (False, False, True)
    assert small.intrinsics_source.startswith("default")


def test_intrinsics_sources_take_precedence_per_view(tmp_path):
    """Camera file, else --fov, else EXIF, else the default; each view says which."""
    paths = [
        photo(tmp_path / "known.png", (400, 300), seed=0, focal_35mm=50),
        photo(tmp_path / "exif.png", (400, 300), seed=1, focal_35mm=50),
        photo(tmp_path / "bare.png", (400, 300), seed=2),
    ]
    cameras = camera_file(
        tmp_path / "mine.json", ("known.png", 400, 300, 320, 210, 140)
    )
    with collecting(Report()) as report:
        loaded = load_photos(paths, cameras=cameras)
    sources = [photo.intrinsics_source for photo in loaded.photos]
    assert sources[0] == f"camera file {cameras}"
    assert sources[1] == "EXIF 35 mm equivalent (50 mm)"
    assert sources[2] == "default (60 degrees across the longer side)"
    fx, _, cx = loaded.views.intrinsics[0, 0, 0].tolist()
    assert (fx, cx) == pytest.approx((320 / 400, 210 / 400))
    assert loaded.photos[2].focal[0] == pytest.approx(200 / math.tan(math.radians(30)))
    assert not any("focal length" in warning for warning in report.warnings)
    assert any(
        "has no camera for exif.png, bare.png" in warning for warning in report.warnings
    )
    with_fov = load_photos(paths, cameras=cameras, fov=70)
    assert [photo.intrinsics_source for photo in with_fov.photos][1:] == [
        "--fov 70",
        "--fov 70",
    ]


def test_camera_file_beside_the_photos_is_found(tmp_path):
    photo(tmp_path / "images" / "a.png", (400, 300))
    camera_file(tmp_path / "cameras.json", ("images/a.png", 400, 300, 320, 200, 150))
    assert "cameras.json" in load_photos(tmp_path).photos[0].intrinsics_source
    assert (
        "cameras.json"
        in load_photos(tmp_path / "images" / "a.png").photos[0].intrinsics_source
    )


def test_poses_come_along_where_one_file_has_them_for_all_photos(tmp_path):
    for name in "abc":
        photo(tmp_path / f"{name}.png")
    poses = [
        torch.eye(4).tolist(),
        [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        None,
    ]
    entries = [
        {
            "file": f"{n}.png",
            "width": 40,
            "height": 30,
            "K": [[32, 0, 20], [0, 32, 15], [0, 0, 1]],
            "c2w": pose,
        }
        for n, pose in zip("abc", poses)
    ]
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    known = load_photos([tmp_path / "a.png", tmp_path / "b.png"]).views.c2w
    assert torch.equal(known, torch.tensor(poses[:2])[None])
    assert load_photos(tmp_path).views.c2w is None


def test_camera_of_a_scaled_copy_is_scaled_along(tmp_path):
    path = photo(tmp_path / "a.png", (200, 150))
    cameras = camera_file(
        tmp_path / "cameras.json", ("a.png", 4000, 3000, 3200, 2100, 1400)
    )
    loaded = load_photos(path, cameras=cameras)
    assert loaded.photos[0].focal == pytest.approx((160, 160))


def test_camera_of_another_shape_is_an_error_when_given_and_ignored_when_found(
    tmp_path,
):
    path = photo(tmp_path / "a.png", (300, 400))
    cameras = camera_file(tmp_path / "cameras.json", ("a.png", 400, 300, 320, 200, 150))
    with pytest.raises(
        InputError, match=r"for a.png is 400x300, but the upright photo is 300x400"
    ):
        load_photos(path, cameras=cameras)
    with collecting(Report()) as report:
        assert "default" in load_photos(path).photos[0].intrinsics_source
    assert any("It is ignored" in warning for warning in report.warnings)


def test_camera_file_without_any_of_the_photos_is_an_error(tmp_path):
    path = photo(tmp_path / "a.png")
    cameras = camera_file(tmp_path / "mine.json", ("b.png", 40, 30, 32, 20, 15))
    with pytest.raises(InputError, match="no camera for any of the photos"):
        load_photos(path, cameras=cameras)


def test_foreign_cameras_json_beside_the_photos_is_ignored_with_a_warning(tmp_path):
    path = photo(tmp_path / "a.png")
    (tmp_path / "cameras.json").write_text('[{"id": 0, "img_name": "a"}]')
    with collecting(Report()) as report:
        load_photos(path)
    assert any("lacks 'width'. It is ignored" in warning for warning in report.warnings)


@pytest.mark.parametrize("fov", [0, 180, -20, math.nan])
def test_impossible_field_of_view_is_an_error(tmp_path, fov):
    with pytest.raises(InputError, match="--fov: expected degrees"):
        load_views(photo(tmp_path / "a.png"), fov=fov)


def test_same_picture_twice_is_warned_of(tmp_path):
    paths = [photo(tmp_path / "a.png"), photo(tmp_path / "b.png")]
    with collecting(Report()) as report:
        load_photos(paths, fov=60)
    assert any("are the same image" in warning for warning in report.warnings)


def test_files_of_one_name_get_numbered_names_and_given_names_must_fit(tmp_path):
    paths = [
        photo(tmp_path / folder / "1.png", seed=i) for i, folder in enumerate("ab")
    ]
    assert load_views(paths).names == ("1-1", "1-2")
    assert load_views(paths, names=["left", "right"]).names == ("left", "right")
    with pytest.raises(InputError, match=r"one per photo \(2\), got 1"):
        load_views(paths, names=["left"])


def test_one_bad_photo_among_good_ones_is_named(tmp_path):
    good, bad = photo(tmp_path / "good.png"), tmp_path / "bad.jpg"
    bad.write_bytes(b"GIF89a")
    with pytest.raises(InputError, match=r"bad\.jpg"):
        load_views([good, bad])


def test_saved_picture_comes_back_bit_equal(tmp_path):
    image = load_views(photo(tmp_path / "a.png")).images[0, 0]
    save_image(image, tmp_path / "b.png")
    assert (
        np.asarray(Image.open(tmp_path / "a.png"))
        == np.asarray(Image.open(tmp_path / "b.png"))
    ).all()


def test_saving_clips_and_rounds_half_to_even(tmp_path):
    image = torch.tensor([-1.0, 2.0, 0.5 / 255, 1.5 / 255, 0.4999 / 255]).expand(
        3, 1, 5
    )
    save_image(image, tmp_path / "a.png")
    assert np.asarray(Image.open(tmp_path / "a.png"))[0, :, 0].tolist() == [
        0,
        255,
        0,
        2,
        0,
    ]


def test_pictures_that_cannot_be_saved_are_errors(tmp_path):
    with pytest.raises(ValueError, match="not finite"):
        save_image(torch.full((3, 2, 2), math.nan), tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"expected shape \[3, height, width\]"):
        save_image(torch.zeros(2, 2), tmp_path / "a.png")
    with pytest.raises(InputError, match="there is no folder"):
        save_image(torch.zeros(3, 2, 2), tmp_path / "none" / "a.png")


@pytest.mark.parametrize(
    ("most", "kept"),
    [(None, "abcde"), (9, "abcde"), (5, "abcde"), (3, "ace"), (2, "ae")],
)
def test_photos_that_are_kept_are_spread_evenly_from_first_to_last(most, kept):
    assert "".join(evenly("abcde", most)) == kept


def test_a_resized_photo_that_is_saved_and_loaded_again_is_bit_equal(tmp_path):
    """`inputs/` of a run is what the run used: a later run from there sees the same bits."""
    paths = [
        photo(tmp_path / "a.png", (400, 300)),
        photo(tmp_path / "b.jpg", (300, 400), seed=1),
    ]
    used = load_views(paths, size=64)
    (tmp_path / "inputs").mkdir()
    for name, image in zip(used.names, used.images[0]):
        save_image(image, tmp_path / "inputs" / f"{name}.png")
    assert torch.equal(load_views(tmp_path / "inputs", size=64).images, used.images)
    steps = torch.round(used.images * 255) / 255
    assert torch.equal(steps, used.images), "photos are in steps of 8 bits"


# ---- names that become files ----


def test_three_photos_with_names_in_each_others_way_are_three_files(tmp_path):
    paths = [
        photo(tmp_path / name, seed=i)
        for i, name in enumerate(("x/p.png", "y/p.png", "p-1.png"))
    ]
    assert load_views(paths).names == ("p-2", "p-3", "p-1")


def test_a_photo_called_like_a_frame_of_the_video_and_one_that_is_no_utf_8_are_loaded(
    tmp_path,
):
    frame = photo(tmp_path / "path_0000.png")
    strange = os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.png")
    try:
        os.rename(photo(tmp_path / "other.png", seed=1), strange)
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    assert load_views([frame, strange]).names == ("_path_0000", "caf_")


def test_a_lens_that_the_photos_tell_straightens_those_of_one_unknown_lens_only(
    tmp_path,
):
    lens = Lens((0.9, 1.2), (0.5, 0.5), (-0.1, 0.0, 0.0, 0.0, 0.0))
    files = [photo(tmp_path / f"{index}.png", seed=index) for index in range(3)]
    plain, found = read_photos(files), read_photos(files, read_lens=lambda views: lens)
    assert (
        all(one.frame.lens == lens for one in found.photos)
        and found.views.assumed == plain.views.assumed
    )
    straight = lens.undistorted(Image.open(files[1]))
    assert torch.equal(
        found.views.images[0, 1],
        torch.from_numpy(np.array(straight, np.float32) / 255).permute(2, 0, 1),
    )
    wide = read_photos(
        files,
        read_lens=lambda views: Lens(
            lens.focal, lens.centre, (0.1, 0.0, 0.0, 0.0, 0.0)
        ),
    )
    # cropped: no dark corners
    assert (wide.views.intrinsics[..., 0, 0] > plain.views.intrinsics[..., 0, 0]).all()
    assert torch.equal(
        read_photos(files, read_lens=lambda views: None).views.images,
        plain.views.images,
    )

    def never(views):
        raise AssertionError(
            "asked for the lens of photos that are of several or of a known one"
        )

    read_photos(files, fov=50, read_lens=never)
    read_photos([*files, photo(tmp_path / "other.png", size=(60, 30))], read_lens=never)


def test_a_camera_file_beside_the_photos_is_named_and_can_be_ignored(tmp_path):
    paths = [photo(tmp_path / f"{name}.png") for name in "ab"]
    camera_file(
        tmp_path / "cameras.json",
        *((path.name, 40, 30, 50, 20, 15) for path in paths),
    )
    with collecting(Report()) as report:
        sources = [p.intrinsics_source for p in load_photos(paths).photos]
    assert all(source.endswith("found beside the photos") for source in sources)
    assert "--cameras none to ignore it" in report.notes["cameras.found"]
    ignored = load_photos(paths, cameras="none")
    assert all(ignored.views.assumed)
