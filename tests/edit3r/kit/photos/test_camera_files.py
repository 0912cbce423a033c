import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras
from edit3r.kit.photos.camera_files import (
    PosedCamera,
    posed_cameras,
    read_cameras,
    write_cameras,
)
from edit3r.kit.photos.intrinsics import Intrinsics, known_poses


def some_cameras(count=3, seed=0):
    generator = torch.Generator().manual_seed(seed)
    c2w = torch.eye(4).repeat(1, count, 1, 1)
    c2w[:, :, :3, 3] = torch.randn(1, count, 3, generator=generator)
    intrinsics = torch.tensor([[0.9, 0, 0.51], [0, 1.2, 0.48], [0, 0, 1]]).repeat(
        1, count, 1, 1
    )
    return Cameras(c2w, intrinsics, (300, 400))


def test_written_cameras_come_back_exactly_in_float32(tmp_path):
    cameras = some_cameras()
    write_cameras(
        tmp_path / "cameras.json", posed_cameras(cameras, ["a.png", "b.png", "c.png"])
    )
    read = read_cameras(tmp_path / "cameras.json")
    assert [(camera.file, camera.width, camera.height) for camera in read] == [
        (f"{n}.png", 400, 300) for n in "abc"
    ]
    for index, camera in enumerate(read):
        np.testing.assert_array_equal(
            camera.c2w.astype(np.float32), cameras.c2w[0, index].numpy()
        )
        np.testing.assert_allclose(
            camera.intrinsics, cameras.intrinsics[0, index].numpy(), rtol=1e-7
        )
        np.testing.assert_allclose(camera.K[0], [0.9 * 400, 0, 0.51 * 400], rtol=1e-6)


def test_what_is_not_known_is_null(tmp_path):
    write_cameras(tmp_path / "cameras.json", [PosedCamera("a.png", 4, 3, None, None)])
    assert json.loads((tmp_path / "cameras.json").read_text())[0]["K"] is None
    camera = read_cameras(tmp_path / "cameras.json")[0]
    assert camera.K is None and camera.c2w is None and camera.intrinsics is None


def transforms(path, frame, **top):
    path.write_text(json.dumps({**top, "frames": [{"file_path": "a.png", **frame}]}))
    return read_cameras(path)[0]


def test_nerfstudio_poses_are_turned_from_opengl_to_opencv_axes(tmp_path):
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    camera = transforms(
        tmp_path / "t.json", {"transform_matrix": matrix.tolist()}, w=4, h=3, fl_x=5
    )
    np.testing.assert_array_equal(camera.c2w[:3, :3], np.diag([1, -1, -1]))
    np.testing.assert_array_equal(camera.c2w[:3, 3], [1, 2, 3])


def test_nerfstudio_intrinsics_at_the_top_or_per_frame(tmp_path):
    top = dict(w=400, h=300, fl_x=320, fl_y=330, cx=210, cy=140)
    np.testing.assert_array_equal(
        transforms(tmp_path / "t.json", {}, **top).K,
        [[320, 0, 210], [0, 330, 140], [0, 0, 1]],
    )
    assert transforms(tmp_path / "t.json", {"fl_x": 100}, **top).K[0, 0] == 100


def test_nerfstudio_angle_alone_means_square_pixels_and_a_centred_principal_point(
    tmp_path,
):
    Image.new("RGB", (80, 60)).save(tmp_path / "a.png")
    camera = transforms(
        tmp_path / "t.json", {"file_path": "./a"}, camera_angle_x=math.pi / 2
    )
    assert (camera.width, camera.height) == (80, 60) and camera.file == "./a.png"
    np.testing.assert_allclose(camera.K, [[40, 0, 40], [0, 40, 30], [0, 0, 1]])


def test_nerfstudio_distortion_is_kept_and_fisheye_refused(tmp_path):
    top = dict(w=4, h=3, fl_x=5)
    assert transforms(tmp_path / "t.json", {}, **top).distortion == ()
    assert transforms(tmp_path / "t.json", {}, k1=0.1, p2=-0.2, **top).distortion == (
        0.1,
        0,
        0,
        -0.2,
        0,
    )
    with pytest.raises(InputError, match=r"t\.json: camera 0 .*OPENCV_FISHEYE"):
        transforms(tmp_path / "t.json", {}, camera_model="OPENCV_FISHEYE", **top)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("{", "not valid JSON"),
        ("3", "expected a list of cameras"),
        ('{"frames": 3}', "expected a list of cameras"),
        ('[{"width": 4, "height": 3}]', "camera 0 lacks 'file'"),
        (
            '[{"file": "a", "width": 4, "height": 3, "K": [[1, 2], [3, 4]]}]',
            "K has shape",
        ),
        ('[{"file": "a", "width": 4, "height": 0}]', "size 4x0"),
        (
            '[{"file": "a", "width": 4, "height": 3, "K": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]}]',
            "expected above 0",
        ),
        (
            '[{"file": "a", "width": 4, "height": 3, "K": [[NaN, 0, 0], [0, 1, 0], [0, 0, 1]]}]',
            "not finite",
        ),
        ('[{"file": "a", "width": "wide", "height": 3}]', "camera 0 cannot be used"),
        ("[7]", "camera 0 cannot be used"),
        ('{"frames": [7]}', "camera 0 cannot be used"),
        ('{"frames": [{"w": 1, "h": 1}]}', "camera 0 lacks 'file_path'"),
    ],
)
def test_faulty_camera_files_are_one_sentence_each(tmp_path, content, expected):
    (tmp_path / "c.json").write_text(content)
    with pytest.raises(InputError) as caught:
        read_cameras(tmp_path / "c.json")
    assert (
        expected in str(caught.value)
        and "c.json" in str(caught.value)
        and "\n" not in str(caught.value)
    )


def test_missing_and_binary_camera_files_are_errors(tmp_path):
    with pytest.raises(InputError, match="no such camera file"):
        read_cameras(tmp_path / "none.json")
    (tmp_path / "c.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not valid JSON"):
        read_cameras(tmp_path / "c.json")


POSE = np.eye(4)


@pytest.mark.parametrize(
    ("c2w", "expected"),
    [
        (np.diag([1.0, 1, 0, 1]), r"no rotation \(lengths 1, 1, 0\)"),
        (np.diag([1000.0, 1000, 1000, 1]), r"no rotation \(lengths 1000"),
        (np.diag([1e200, 1, 1, 1]), "no rotation"),
        (np.diag([1.0, 1, -1, 1]), "mirrors the world"),
        (np.diag([1.0, 1, 1, 7]), "last row of c2w is 0, 0, 0, 7"),
        (POSE + 1e30 * np.eye(4, k=3), "position in c2w is 1e\\+30"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.eye(3), r"shape \(3, 3\)"),
    ],
)
def test_poses_that_are_none_name_file_and_camera(tmp_path, c2w, expected):
    entry = {"file": "a.png", "width": 4, "height": 3, "K": None}
    (tmp_path / "c.json").write_text(
        json.dumps([{**entry, "c2w": POSE.tolist()}, {**entry, "c2w": c2w.tolist()}])
    )
    with pytest.raises(
        InputError, match=rf"c\.json: camera 1 cannot be used \(.*{expected}"
    ):
        read_cameras(tmp_path / "c.json")


NAMES = (".", "", "..", "a\0b", None, 3, "x" * 5000)
SIZES = ("4", 1.5, 0, 10**9, 1e400, None, [4])
NUMBERS = [
    ([[4, 0, 2], [0, 4, 2], [0, 0, 5]], ".*K has other numbers"),
    ([[4, 0, 2], [9, 4, 2], [0, 0, 1]], ".*K has other numbers"),
    ([[4, 0, 2], [0, 4, 2], [3, 1, 1]], ".*K has other numbers"),
    ([[4, 0, 1e9], [0, 4, 2], [0, 0, 1]], ".*principal point of K is 1e"),
    ([[4, 0, 2], [0, 1e9, 2], [0, 0, 1]], ".*focal lengths 4, 1e"),
    ([[4, 0, 2], [0, 0, 2], [0, 0, 1]], ".*focal lengths 4, 0, expected above 0"),
    ([[4, 0, 2], [0, 4], [0, 0, 1]], "cannot be used"),
]


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        *(({"file": name}, "cannot be used") for name in NAMES),
        *(({"width": size}, "cannot be used") for size in SIZES),
        *(({"K": row}, told) for row, told in NUMBERS),
    ],
)
def test_cameras_that_cannot_be_name_file_and_camera(tmp_path, changed, expected):
    row = {"file": "a.png", "width": 4, "height": 3, **changed}
    (tmp_path / "c.json").write_text(json.dumps([row]))
    with pytest.raises(InputError, match=rf"c\.json: camera 0 {expected}"):
        read_cameras(tmp_path / "c.json")


def test_poses_of_two_files_or_of_some_photos_only_are_none():
    """Those of two files have no frame in common."""
    one, two = (
        Intrinsics(torch.eye(3), source, torch.eye(4).double()) for source in ("a", "b")
    )
    assert known_poses([one, one]).shape == (2, 4, 4)
    assert known_poses([one, two]) is None
    assert known_poses([one, replace(one, c2w=None)]) is None


@pytest.mark.parametrize("quaternion", ["0 0 0 0", "0.0 -0.0 0 0", "1e-9 0 0 0"])
def test_a_colmap_pose_without_a_rotation_is_refused(tmp_path, quaternion):
    pytest.importorskip("pycolmap")
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 100 80 90 90 50 40\n")
    (tmp_path / "images.txt").write_text(f"1 {quaternion} 0 0 0 1 a.jpg\n\n")
    (tmp_path / "points3D.txt").write_text("")
    with pytest.raises(InputError, match="no rotation"):
        read_cameras(tmp_path)
