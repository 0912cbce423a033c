"""Camera files as other programs and systems write them are read, or refused in one sentence."""

import json
import struct
import unicodedata
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.geometry.rotations import matrices_to_quats
from edit3r.kit.photos.camera_files import read_cameras, read_scene_cameras
from edit3r.kit.photos.images import load_photos
from edit3r.kit.photos.posed_folder import read_posed_folder

WIDTH, HEIGHT, FOCAL = 24, 16, 40.0
TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def pose(step):
    turned = np.eye(4)
    angle = 0.3 * step
    turned[:3, :3] = [
        [np.cos(angle), 0, np.sin(angle)],
        [0, 1, 0],
        [-np.sin(angle), 0, np.cos(angle)],
    ]
    turned[:3, 3] = 0.5 * step, 0.1, -0.2
    return turned


def photos(folder, names=("left.png", "right.png")):
    folder.mkdir(parents=True, exist_ok=True)
    for shade, name in enumerate(names):
        Image.new("RGB", (WIDTH, HEIGHT), (40 + shade, 90, 120)).save(folder / name)
    return [folder / name for name in names]


def frames(names, **more):
    return [
        {
            "file_path": name,
            "fl_x": FOCAL,
            "cx": 11.0,
            "cy": 7.5,
            "w": WIDTH,
            "h": HEIGHT,
            "transform_matrix": (pose(step) @ TO_OPENGL).tolist(),
            **more,
        }
        for step, name in enumerate(names)
    ]


NAMES = ["images/left.png", "images/right.png"]


def loaded(files, cameras=None):
    """The views, and what was said; their poses must be those that were written."""
    with collecting(Report()) as report:
        views = load_photos(files, cameras=cameras, size=None).views
    return views, report


def assert_known(views, cx=11.0):
    expected = np.stack([pose(0), pose(1)])
    np.testing.assert_allclose(views.c2w[0].numpy(), expected, atol=1e-6)
    assert views.intrinsics[0, 0, 0, 0] == pytest.approx(FOCAL / WIDTH)
    assert views.intrinsics[0, 0, 0, 2] == pytest.approx(cx / WIDTH)


DIALECTS = {
    "plain": {"frames": frames(NAMES)},
    "backslashes": {"frames": frames([n.replace("/", "\\") for n in NAMES])},
    "dot": {"frames": frames([f"./{n}" for n in NAMES])},
    "no suffix": {"frames": frames([n[:-4] for n in NAMES])},
    "of Windows": {"frames": frames([f"C:\\scans\\{n}" for n in NAMES])},
    "from elsewhere": {"frames": frames([f"/home/me/scan/{n}" for n in NAMES])},
    "elsewhere without suffix": {"frames": frames([f"/scan/{n}"[:-4] for n in NAMES])},
    "other case": {"frames": frames(["images/LEFT.PNG", "images/Right.png"])},
    "lower model": {"camera_model": "pinhole", "frames": frames(NAMES)},
    "k4 of 0": {"camera_model": "OPENCV", "k4": 0, "frames": frames(NAMES)},
    "no fisheye": {"is_fisheye": False, "frames": frames(NAMES)},
    "gone": {"frames": [*frames(NAMES), {"file_path": "images/gone.png", "fl_x": 9}]},
    "gone and damaged": {"frames": [*frames(NAMES), {"file_path": "b.png", "w": "?"}]},
    "another format": {"frames": frames([n.replace(".png", ".jpg") for n in NAMES])},
    "moved by applied_transform": {
        "applied_transform": [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]],
        "frames": frames(NAMES),
    },
    "nulls": {"frames": frames(NAMES, k1=None, p1=None, mask_path=None)},
    "three rows of a pose": {
        "frames": [
            one | {"transform_matrix": one["transform_matrix"][:3]}
            for one in frames(NAMES)
        ]
    },
    "whole numbers with a point": {"frames": frames(NAMES, w=24.0, h=16.0)},
    "listed twice alike": {"frames": frames(NAMES) + frames(NAMES)},
}


@pytest.mark.parametrize("content", DIALECTS.values(), ids=DIALECTS)
@pytest.mark.parametrize("given", [True, False])
def test_a_transforms_json_of_any_program_is_read(tmp_path, content, given):
    files = photos(tmp_path / "images")
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(content))
    views, report = loaded(files, path if given else None)
    assert_known(views)
    assert not report.warnings


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_a_camera_file_of_a_windows_editor_is_read(tmp_path, encoding):
    files = photos(tmp_path / "images")
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(DIALECTS["plain"]), encoding)
    assert_known(loaded(files)[0])


def test_names_with_accents_are_found_however_they_are_written(tmp_path):
    names = [unicodedata.normalize("NFC", f"caf\u00e9 {i}.png") for i in range(2)]
    files = photos(tmp_path, names)
    content = {"frames": frames([unicodedata.normalize("NFD", n) for n in names])}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    assert_known(loaded(files)[0])


def test_a_centre_of_null_is_the_middle(tmp_path):
    files = photos(tmp_path / "images")
    content = {"frames": frames(NAMES, cx=None, cy=None)}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    assert_known(loaded(files)[0], cx=WIDTH / 2)


def test_an_angle_alone_takes_the_size_of_the_photo(tmp_path):
    files = photos(tmp_path / "train", ("r_0.png", "r_1.png"))
    for part, step in (("train", 0), ("test", 1)):
        frame = {"file_path": f"./train/r_{step}"}
        frame["transform_matrix"] = (pose(step) @ TO_OPENGL).tolist()
        angle = 2 * np.arctan(WIDTH / 2 / FOCAL)
        content = {"camera_angle_x": angle, "frames": [frame]}
        (tmp_path / f"transforms_{part}.json").write_text(json.dumps(content))
    assert_known(loaded(files)[0], cx=WIDTH / 2)


def test_smaller_copies_of_the_photos_have_their_cameras_and_another_scene_has_none(
    tmp_path,
):
    photos(tmp_path / "images")
    copies, others = photos(tmp_path / "images_2"), photos(tmp_path / "other")
    (tmp_path / "transforms.json").write_text(json.dumps(DIALECTS["plain"]))
    assert_known(loaded(copies)[0])
    assert loaded(others)[0].c2w is None


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"is_fisheye": True, "k1": 0.05}, "is_fisheye"),
        ({"camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE"),
        ({"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR"),
        ({"camera_model": "opencv", "k1": 0.01, "k4": 0.3}, "k4 is 0.3"),
        ({"camera_angle_x": 7, "fl_x": None}, "camera_angle_x is 7"),
    ],
)
def test_a_lens_that_cannot_be_undone_is_refused(tmp_path, more, told):
    files = photos(tmp_path / "images")
    path = tmp_path / "given.json"
    path.write_text(json.dumps({"frames": frames(NAMES, **more)}))
    with pytest.raises(InputError, match=told):
        loaded(files, path)


@pytest.mark.parametrize(
    "changed", [{"fl_x": 50.0}, {"transform_matrix": pose(3).tolist()}]
)
def test_a_camera_named_twice_with_two_answers_is_refused(tmp_path, changed):
    files = photos(tmp_path / "images")
    twice = [*frames(NAMES), *frames(NAMES, **changed)]
    path = tmp_path / "given.json"
    path.write_text(json.dumps({"frames": twice}))
    with pytest.raises(InputError, match="2 times, with cameras that differ"):
        loaded(files, path)


@pytest.mark.parametrize(
    "wrong",
    [{"w": True}, {"k1": []}, {"k1": {}}, {"fl_x": 0}, {"file_path": "\ud800.png"}],
)
def test_a_value_of_another_kind_is_refused(tmp_path, wrong):
    files = photos(tmp_path / "images")
    path = tmp_path / "given.json"
    path.write_text(json.dumps({"frames": [f | wrong for f in frames(NAMES)]}))
    with pytest.raises(InputError, match=r"given\.json"):
        loaded(files, path)


def test_a_photo_that_may_be_either_of_two_images_of_its_name_is_refused(tmp_path):
    files = photos(tmp_path / "images")
    first = [f"a/{name}" for name in NAMES]
    second = [f"b/{name}" for name in NAMES]
    other = {"transform_matrix": pose(3).tolist()}
    path = tmp_path / "given.json"
    path.write_text(json.dumps({"frames": [*frames(first), *frames(second, **other)]}))
    with pytest.raises(InputError, match=r"may be a.* or b"):
        loaded(files, path)


def test_masks_that_a_camera_file_names_are_their_photos(tmp_path):
    files = photos(tmp_path / "images")
    content = {"frames": frames(NAMES, mask_path="masks\\left.png")}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    (mask,) = {photo.mask for photo in load_photos(files).photos}
    assert Path(mask) == tmp_path / "masks" / "left.png"


# The list of 3D Gaussian Splatting


@pytest.mark.parametrize("ending", ["", ".png"])
def test_the_list_of_3dgs_is_a_camera_file(tmp_path, ending):
    files = photos(tmp_path / "images")
    content = [
        {
            "id": step,
            "img_name": f"{name}{ending}",
            "width": WIDTH,
            "height": HEIGHT,
            "position": pose(step)[:3, 3].tolist(),
            "rotation": pose(step)[:3, :3].tolist(),
            "fx": FOCAL,
            "fy": FOCAL,
        }
        for step, name in enumerate(("left", "right"))
    ]
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    assert_known(loaded(files)[0], cx=WIDTH / 2)
    cameras, _ = read_scene_cameras(tmp_path / "cameras.json")
    np.testing.assert_allclose(cameras.c2w[0, 1].numpy(), pose(1), atol=1e-6)


# COLMAP's models


LENSES = {
    "SIMPLE_PINHOLE": (FOCAL, 11.0, 7.5),
    "PINHOLE": (FOCAL, FOCAL, 11.0, 7.5),
    "SIMPLE_RADIAL": (FOCAL, 11.0, 7.5, 0.02),
    "RADIAL": (FOCAL, 11.0, 7.5, 0.02, 0.01),
    "OPENCV": (FOCAL, FOCAL, 11.0, 7.5, 0.02, 0.01, 0.001, 0.002),
    "FULL_OPENCV": (FOCAL, FOCAL, 11.0, 7.5, 0.02, 0.01, 0, 0, 0.01, 0, 0, 0),
}
NUMBERS = {
    name: number
    for number, name in enumerate(
        ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
    )
}


def inverse(step):
    w2c = np.linalg.inv(pose(step))
    quaternion = matrices_to_quats(torch.from_numpy(w2c[:3, :3])[None])[0]
    return (*quaternion.tolist(), *w2c[:3, 3])


def write_text(folder, names, lens="PINHOLE", gap="\n10 10 5 20 20 -1 3 3 7 1 2 9\n"):
    folder.mkdir(parents=True)
    numbers = " ".join(map(str, LENSES[lens]))
    (folder / "cameras.txt").write_text(
        f"# Camera list\n1 {lens} {WIDTH} {HEIGHT} {numbers}\n"
    )
    lines = [
        f"{step + 1} {' '.join(map(repr, map(float, inverse(step))))} 1 {name}{gap}"
        for step, name in enumerate(names)
    ]
    (folder / "images.txt").write_text("# Image list\n" + "".join(lines), "utf-8")


def write_binary(folder, names, lens="PINHOLE"):
    folder.mkdir(parents=True)
    values = LENSES[lens]
    camera = struct.pack("<Ii2Q", 1, NUMBERS[lens], WIDTH, HEIGHT)
    camera += struct.pack(f"<{len(values)}d", *values)
    (folder / "cameras.bin").write_bytes(struct.pack("<Q", 1) + camera)
    images = struct.pack("<Q", len(names))
    for step, name in enumerate(names):
        images += struct.pack("<I7dI", step + 1, *inverse(step), 1)
        images += name.encode() + b"\0" + struct.pack("<Q2dQ", 1, 3.0, 4.0, 7)
    (folder / "images.bin").write_bytes(images)


@pytest.mark.parametrize("write", [write_text, write_binary])
@pytest.mark.parametrize("place", ["sparse/0", "sparse", ".", "colmap/sparse/0"])
def test_a_colmap_model_beside_the_photos_is_found(tmp_path, write, place):
    files = photos(tmp_path / "scene" / "images")
    if place == ".":
        place = "images/model"  # not beside: given
    write(tmp_path / "scene" / place, ("left.png", "right.png"))
    given = tmp_path / "scene" / place if place.endswith("model") else None
    assert_known(loaded(files, given)[0])


@pytest.mark.parametrize("given", ["", "sparse", "sparse/0", "sparse/0/images.txt"])
def test_a_model_is_given_by_its_folder_its_scene_or_a_file(tmp_path, given):
    files = photos(tmp_path / "elsewhere")
    write_text(tmp_path / "scene/sparse/0", ("left.png", "right.png"))
    assert_known(loaded(files, tmp_path / "scene" / given)[0])


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("write", [write_text, write_binary])
def test_colmaps_lenses_are_those_of_opencv(tmp_path, lens, write):
    if write is write_binary and lens not in NUMBERS:
        return
    write(tmp_path / "model", ("left.png",), lens)
    (camera,) = read_cameras(tmp_path / "model")
    np.testing.assert_allclose(camera.K, [[FOCAL, 0, 11], [0, FOCAL, 7.5], [0, 0, 1]])
    np.testing.assert_allclose(camera.c2w, pose(0), atol=1e-12)
    of_centre = 3 if len(LENSES[lens]) < 6 and lens != "PINHOLE" else 4
    expected = tuple(LENSES[lens][of_centre:])
    assert camera.distortion == expected
    (file,) = photos(tmp_path / "images", ["left.png"])
    focal = loaded([file], tmp_path / "model")[0].intrinsics[0, 0, 0, 0]
    # of what is left, straightened
    assert focal == pytest.approx(FOCAL / WIDTH, rel=0.1)


@pytest.mark.parametrize("gap", ["\n\n", "\n", "\r\n\r\n"])
def test_names_with_spaces_and_lines_without_points_are_read(tmp_path, gap):
    names = ("my left photo.png", "\u0444\u043e\u0442\u043e 2.png")
    files = photos(tmp_path / "images", names)
    write_text(tmp_path / "sparse/0", names, gap=gap)
    assert_known(loaded(files)[0])


def test_photos_in_folders_of_cameras_keep_apart(tmp_path):
    files = [photos(tmp_path / "images" / one, ("1.png",))[0] for one in ("a", "b")]
    write_text(tmp_path / "sparse/0", ("a/1.png", "b/1.png"))
    assert_known(loaded(files, tmp_path / "sparse/0")[0])


def test_a_colmap_fisheye_and_a_damaged_model_are_one_sentence(tmp_path):
    write_text(tmp_path / "fisheye", ("left.png",))
    line = f"1 SIMPLE_RADIAL_FISHEYE {WIDTH} {HEIGHT} 40 12 8 0.1\n"
    (tmp_path / "fisheye/cameras.txt").write_text(line)
    with pytest.raises(InputError, match="SIMPLE_RADIAL_FISHEYE, expected a pinhole"):
        read_cameras(tmp_path / "fisheye")
    write_binary(tmp_path / "cut", ("left.png",))
    content = (tmp_path / "cut/images.bin").read_bytes()
    (tmp_path / "cut/images.bin").write_bytes(content[:40])
    with pytest.raises(InputError, match="no COLMAP model that can be read"):
        read_cameras(tmp_path / "cut")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds neither a COLMAP model"):
        read_cameras(tmp_path / "empty")


def test_a_folder_with_a_model_can_be_evaluated(tmp_path):
    photos(tmp_path / "images")
    write_text(tmp_path / "sparse/0", ("left.png", "right.png"))
    folder = read_posed_folder(tmp_path)
    assert [Path(camera.file).name for camera in folder.cameras] == [
        "left.png",
        "right.png",
    ]
    assert folder.load(1, 8).image.shape == (8, 8, 3)
