"""A known length sets the scale of the scene and three level places which way is up: of its files,
of what goes on from them, and not of what cannot have one.
"""

import json
import math
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import skimage
import torch

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Cameras, Reconstruction, Rendering, Views
from edit3r.kit.geometry.cameras import pixel_rays
from edit3r.kit.scenes.reading import load_scene
from edit3r.running.config import make_run_config
from edit3r.running.job import RunJob
from edit3r.running.measuring import METRES, measure, with_what_is_known
from edit3r.running.records import Inputs
from edit3r.running.run_folder import RunFolder
from edit3r.running.steps.read import read
from edit3r.running.unit import GIVEN, Unit
from edit3r_testing.scenes import gaussian_cloud

# of the packaged pair, Middlebury 2014: https://vision.middlebury.edu/stereo/data/scenes2014
BASELINE, FOCAL, CENTRE, OFFSET = 0.193001, 994.978, (311.193, 254.877), 31.086
ENDS, OTHERS = ((330, 225), (600, 330)), ((250, 250), (450, 180), (190, 300))
FLOOR = ((250, 450), (650, 480), (450, 400))  # on the left photo; told
ON_FLOOR = ((450, 420), (240, 440), (560, 470))
QUICK = ["--editor", "none", "--size", "256", "--outputs", "scene,images"]


def disparities():
    folder = Path(skimage.__file__).parent / "data"
    return np.load(folder / "motorcycle_disp.npz")["arr_0"]


def truth(x, y):
    """Where the surface is that a pixel of the left photo shows [m]."""
    around = disparities()[y - 2 : y + 3, x - 2 : x + 3]
    depth = BASELINE * FOCAL / (np.median(around) + OFFSET)
    return depth * np.array([*((np.array([x, y]) + 0.5 - CENTRE) / FOCAL), 1])


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A run of the packaged pair that is told how far two things are apart, and three places on the
    floor.
    """
    out = tmp_path_factory.mktemp("measured") / "out"
    apart = 100 * np.linalg.norm(truth(*ENDS[0]) - truth(*ENDS[1]))
    told = ",".join(f"1:{x},{y}" for x, y in ENDS) + f"={apart:.2f} cm"
    level = ",".join(f"1:{x},{y}" for x, y in FLOOR)
    words = [*QUICK, "--export", "glb,spz,viewer", "--measure", told, "--up", level]
    assert main(["run", *words, "--out", str(out)]) == 0
    return out


def baseline(run):
    first, second = json.loads((run / "cameras.json").read_text())
    return np.linalg.norm(np.subtract(second["c2w"], first["c2w"])[:3, 3])


def left_camera(run):
    """How the camera of the left photo is turned."""
    return np.array(json.loads((run / "cameras.json").read_text())[0]["c2w"])[:3, :3]


def surface_at(scene, x, y):
    """Median centre of the Gaussians about a pixel of the left photo, in the scene's frame."""
    means = load_scene(scene).means[0].numpy()
    seen = means @ left_camera(scene.parent)
    means, seen = means[seen[:, 2] > 0], seen[seen[:, 2] > 0]
    place = FOCAL * seen[:, :2] / seen[:, 2:] + CENTRE
    return np.median(means[(np.abs(place - (x, y)) < 8).all(1)], 0)


def depth_at(scene, x, y):
    return surface_at(scene, x, y) @ left_camera(scene.parent)[:, 2]


def require_upright(scene):
    """Asserts that places of the floor that were not told lie at one height, and that what points
    up in truth does.
    """
    heights = [surface_at(scene, *place)[1] for place in ON_FLOOR]
    assert np.ptp(heights) < 0.02  # m, of a floor 1.5 m deep
    first, second, third = (truth(*place) for place in ON_FLOOR)
    normal = np.cross(second - first, third - first)
    up = left_camera(scene.parent) @ normal / np.linalg.norm(normal)
    assert abs(up[1]) > np.cos(np.radians(2))


FILES = ["scene.ply", "scene.glb", "scene.spz"]


@pytest.mark.slow
@pytest.mark.parametrize("file", FILES)
def test_the_floor_is_level_in_files_once_three_places_told_it(measured, file):
    require_upright(measured / file)
    facts = json.loads((measured / "run.json").read_text())
    assert facts["frame"].startswith("turned about view 0's camera so that y points")
    assert (
        facts["notes"]["up"][1] < -0.9 and "three places" in facts["notes"]["up.told"]
    )


@pytest.mark.slow
def test_the_viewer_turns_about_the_told_up(measured, tmp_path):
    assert '"up": [0.0, -1.0, 0.0]' in (measured / "viewer.html").read_text()
    out = tmp_path / "again.html"
    assert main(["export", str(measured), "--to", "viewer", "--out", str(out)]) == 0
    assert '"up": [0.0, -1.0, 0.0]' in out.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("file", FILES)
def test_all_lengths_are_in_metres_within_3_per_cent(measured, file):
    assert baseline(measured) == pytest.approx(BASELINE, rel=0.03)
    for place in OTHERS:
        depth = depth_at(measured / file, *place)
        assert depth == pytest.approx(truth(*place)[2], rel=0.03)
    facts = json.loads((measured / "run.json").read_text())
    assert facts["frame"].endswith("in metres")
    assert facts["notes"]["scale.measured"]["metres"] == pytest.approx(0.69, abs=0.01)


@pytest.mark.slow
def test_what_goes_on_from_it_is_in_metres_and_upright_too(measured, tmp_path):
    words = ["run", "--from", str(measured), "--prompt", "make everything warmer"]
    out = tmp_path / "out"
    assert main([*words, "--refine", "0", "--out", str(out)]) == 0
    assert baseline(out) == pytest.approx(baseline(measured), rel=1e-4)
    for place in OTHERS:
        depth = depth_at(out / "scene.ply", *place)
        assert depth == pytest.approx(truth(*place)[2], rel=0.03)
    require_upright(out / "scene.ply")
    assert np.allclose(left_camera(out), left_camera(measured), atol=1e-6)


def inputs(views=2, height=40, width=60, sky=False, **known):
    images = torch.full((1, views, 3, height, width), 0.4)
    images[..., 20:, :] += 0.2 * torch.rand(1, views, 3, height - 20, width)
    if sky:
        images[:, :, :, :20] = torch.tensor([0.45, 0.65, 0.95])[:, None, None]
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1.5, 0.5], [0, 0, 1]])
    names = tuple("abc"[:views])
    photos = Views(images, lens.expand(1, views, 3, 3), names)
    return Inputs(photos, photos, **known)


def knowing(given=None, **told):
    return with_what_is_known(given or inputs(), make_run_config(told))


@pytest.mark.parametrize(
    ("flag", "text", "told"),
    [
        *(
            ("measure", *one)
            for one in (
                ("1:10,10,1:50,10", "expected [N:]X,Y,[N:]X,Y=LENGTH"),
                ("1:10,10=2m", "expected [N:]X,Y,[N:]X,Y=LENGTH"),
                ("1:10,10,1:50,10=2", "the unit '', expected one of m, cm, mm, ft, in"),
                ("1:10,10,1:50,10=2 miles", "got the unit 'miles'"),
                ("1:10,10,1:50,10=0m", "a length must be a number above 0"),
                ("1:10,10,1:50,10=1.2.3m", "a length must be a number above 0"),
                ("1:10,10,1:10,10=2m", "both places are the same"),
                ("1:10,10,1:70,10=2m", "lies outside of what is used of photo 1"),
                ("1:10,10,3:50,10=2m", "on photo N (1 to 2)"),
            )
        ),
        *(
            ("up", *one)
            for one in (
                ("+z", "no axes; expected found (as they were held), or [N:]X,Y"),
                ("1:10,10,1:50,10", "expected found (as they were held), or [N:]X,Y"),
                ("1:10,10,1:30,10.2,1:50,10", "the three places lie on one line"),
                ("1:10,10,1:10,10,1:50,30", "the three places lie on one line"),
                ("1:10,10,1:50,10,1:30,50", "outside of what is used of photo 1"),
                ("1:10,10,3:50,10,1:30,30", "on photo N (1 to 2)"),
            )
        ),
    ],
)
def test_what_tells_no_length_or_plane_is_one_sentence_before_work(flag, text, told):
    with pytest.raises(InputError) as caught:
        knowing(**{flag: text})
    assert told in str(caught.value) and str(caught.value).startswith(f"--{flag} ")


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("m", 2), ("cm", 0.02), ("mm", 0.002), ("ft", 0.6096), ("in", 0.0508)],
)
def test_units_are_read(unit, metres):
    known = knowing(measure=f"10,10, 50,10 = 2 {unit}").length
    assert known.metres == pytest.approx(metres) and unit in METRES
    assert known.ends[1] == ("a", pytest.approx(50 / 60), pytest.approx(10 / 40))


def asked(
    text,
    unit=GIVEN,
    poses=None,
    flag="measure",
    down=0,
    geometry=None,
    **changed,
):
    """What is known of a wall 2 before both cameras; view b is 1 to the right."""
    given = inputs(unit=unit, **changed)
    if poses is not None:
        given = Inputs(
            photos=Views(
                given.photos.images, given.photos.intrinsics, ("a", "b"), poses
            ),
            start=given.start,
            unit=unit,
        )
    known = knowing(given, **{flag: text})
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = 1
    cameras = Cameras(c2w, given.photos.intrinsics, given.photos.image_size)
    shape = (1, 2, 1, *given.photos.image_size)
    depths, alphas = torch.full(shape, 2.0), torch.ones(shape)
    if down:  # a level plane at one depth on the middle axis, seen by a camera that looks down
        rays = pixel_rays(given.photos.intrinsics[0, 0], given.photos.image_size)
        angle = math.radians(down)
        sink = rays @ torch.tensor([0, math.cos(angle), math.sin(angle)])
        depths[:] = 2 * math.sin(angle) / sink
    alphas[..., :10, :10] = 0
    rendered = Rendering(given.photos.images, alphas, depths)
    made = SimpleNamespace(
        reconstruction=Reconstruction(None, cameras), cameras=cameras
    )
    return measure(known, geometry, made, rendered, False)


def test_two_places_may_be_on_two_photos():
    # x from -0.5 to 0.5 is 2 wide at depth 2, and photo b stands 1 to the right
    assert asked("1:0.25,0.5,1:0.75,0.5=1m").scale == pytest.approx(1, rel=1e-4)
    assert asked("1:0.25,0.5,2:0.75,0.5=1m").scale == pytest.approx(0.5, rel=1e-4)


def test_given_poses_are_scaled_with_the_scene():
    """They are in a unit of 4 of the run's."""
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, 1, 0, 3] = 1
    unit = Unit(torch.tensor([0.25], dtype=torch.float64))
    assert asked("1:0.25,0.5,1:0.75,0.5=1m", unit, poses).scale == pytest.approx(
        0.25, 1e-4
    )


LEVEL = "1:0.3,0.3,1:0.7,0.3,1:0.5,0.7"


@pytest.mark.parametrize("down", [20, 45, 70, -30])
def test_up_is_the_plane_s_normal_away_from_the_ground(down):
    """Floors are seen from above, ceilings from below: both tell the same up."""
    up = asked(LEVEL, flag="up", down=down).up
    angle = np.radians(down)
    assert up == pytest.approx((0, -np.cos(angle), -np.sin(angle)), abs=1e-3)


def test_up_is_found_as_the_photos_were_held():
    assert asked("found", flag="up").up == pytest.approx((0, -1, 0), abs=1e-6)


def test_a_place_without_a_surface_is_named():
    with pytest.raises(InputError, match="the second place shows nothing that"):
        asked("1:30,30,1:4,4=1m")
    with pytest.raises(InputError, match="the first place shows the sky"):
        asked("1:30,5,1:30,30=1m", sky=True)


@pytest.mark.parametrize(
    ("flag", "text", "told"),
    [
        ("measure", "1:1,1,1:9,9=1m", "a given scene keeps its unit"),
        ("up", "1:1,1,1:9,9,1:1,9", "a given scene keeps its axes; expected which"),
    ],
)
def test_a_given_scene_keeps_its_unit_and_axes_before_it_is_read(flag, text, told):
    job = RunJob(make_run_config({flag: text}), scene=Path("none.ply"))
    with pytest.raises(InputError, match=told):
        read(job, lambda views: None, lambda: None)


def test_a_photo_that_is_left_out_tells_no_length():
    known = knowing(measure="1:30,30,2:30,30=1m").select([0])
    shape = (1, 1, 1, 40, 60)
    rendered = Rendering(known.photos.images, torch.ones(shape), torch.ones(shape))
    cameras = Cameras(
        torch.eye(4)[None, None], known.photos.intrinsics, known.photos.image_size
    )
    made = SimpleNamespace(
        reconstruction=Reconstruction(None, cameras), cameras=cameras
    )
    with pytest.raises(InputError, match="second place is on b, which is no part"):
        measure(known, None, made, rendered, False)


def test_a_place_whose_depth_was_guessed_is_warned_of():
    confidence = torch.ones(1, 2, 40, 60)
    confidence[0, 0, :, 30:] = 0.4  # the right half of photo a
    placed = torch.ones(1, 2, dtype=torch.bool)
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    geometry = Geometry(poses, torch.ones(1, 2, 40, 60), confidence, placed)
    with pytest.warns(UserWarning, match="second place is seen by one photo alone"):
        asked("1:0.25,0.5,1:0.75,0.5=1m", geometry=geometry)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        asked("1:0.25,0.5,2:0.75,0.5=1m", geometry=geometry)


def test_python_takes_the_same_words():
    with pytest.raises(InputError, match="--measure 1:2: expected"):
        edit3r.run(inputs().photos, editor="none", measure="1:2")
    with pytest.raises(InputError, match="--up 1:2: photos have no axes"):
        edit3r.run(inputs().photos, editor="none", up="1:2")


def test_what_goes_on_from_a_run_begins_in_its_own_frame_and_unit():
    """View 0 is exactly the identity again: nothing else may know of the turn."""
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, :3, 3] = torch.tensor([1.0, 2, 3])
    photos = inputs().photos
    cameras = Cameras(c2w, photos.intrinsics, photos.image_size)
    gaussians = gaussian_cloud(5)
    points = gaussians.means
    # in float32, no turn and its back are exactly the identity
    made, up = Reconstruction(gaussians, cameras), (0.26, -0.82, -0.5099)
    written = GIVEN.times(3.0).upright(up).reconstruction(made)
    assert written.cameras.c2w[0, 0, 1, 1] == pytest.approx(0.82)  # camera 0 is tilted
    seen = written.gaussians.means @ written.cameras.c2w[0, 0, :3, :3] / 3
    torch.testing.assert_close(seen, points)  # as before, from camera 0
    again = inputs(before=written, scale=3.0, up=up).unmeasured().before
    assert torch.equal(again.cameras.c2w[0, 0], torch.eye(4))
    torch.testing.assert_close(again.cameras.c2w, c2w)
    for name in ("means", "scales", "harmonics"):
        one, other = getattr(again.gaussians, name), getattr(gaussians, name)
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("up", ["[0, 2, 0]", '"up"', "[0, 1]", "7"])
def test_an_up_that_is_none_is_not_believed(tmp_path, up):
    folder = RunFolder(tmp_path)
    folder.manifest.write_text(f'{{"notes": {{"up": {up}}}}}')
    assert folder.up is None
    folder.manifest.write_text('{"notes": {"up": [0, -0.8, -0.6]}}')
    assert folder.up == (0, -1, 0)
