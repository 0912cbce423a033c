"""A known length sets the scale of the scene: of its files, of what goes on from them, and not of
what cannot have one.
"""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import skimage
import torch

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras, Reconstruction, Rendering, Views
from edit3r.kit.scenes.reading import load_scene
from edit3r.running.measuring import METRES, measure, with_known_length
from edit3r.running.records import Inputs
from edit3r.running.scale import GIVEN, Unit

# of the packaged pair, Middlebury 2014: https://vision.middlebury.edu/stereo/data/scenes2014
BASELINE, FOCAL, CENTRE, OFFSET = 0.193001, 994.978, (311.193, 254.877), 31.086
ENDS, OTHERS = ((330, 225), (600, 330)), ((250, 250), (450, 180), (190, 300))
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
    """A run of the packaged pair that is told how far two things are apart."""
    out = tmp_path_factory.mktemp("measured") / "out"
    apart = 100 * np.linalg.norm(truth(*ENDS[0]) - truth(*ENDS[1]))
    told = ",".join(f"1:{x},{y}" for x, y in ENDS) + f"={apart:.2f} cm"
    words = [*QUICK, "--export", "glb", "--measure", told]
    assert main(["run", *words, "--out", str(out)]) == 0
    return out


def baseline(run):
    first, second = json.loads((run / "cameras.json").read_text())
    return np.linalg.norm(np.subtract(second["c2w"], first["c2w"])[:3, 3])


def depth_at(scene, x, y):
    """Median depth of the Gaussians about a pixel of the left photo."""
    means = load_scene(scene).means[0].numpy()
    means = means[means[:, 2] > 0]
    place = FOCAL * means[:, :2] / means[:, 2:] + CENTRE
    near = (np.abs(place - (x, y)) < 8).all(1)
    return np.median(means[near, 2])


@pytest.mark.slow
@pytest.mark.parametrize("file", ["scene.ply", "scene.glb"])
def test_all_lengths_are_in_metres_within_3_per_cent(measured, file):
    assert baseline(measured) == pytest.approx(BASELINE, rel=0.03)
    for place in OTHERS:
        depth = depth_at(measured / file, *place)
        assert depth == pytest.approx(truth(*place)[2], rel=0.03)
    facts = json.loads((measured / "run.json").read_text())
    assert facts["frame"].endswith("in metres")
    assert facts["notes"]["scale.measured"]["metres"] == pytest.approx(0.69, abs=0.01)


@pytest.mark.slow
def test_what_goes_on_from_it_is_in_metres_too(measured, tmp_path):
    words = ["run", "--from", str(measured), "--prompt", "make everything warmer"]
    out = tmp_path / "out"
    assert main([*words, "--refine", "0", "--out", str(out)]) == 0
    assert baseline(out) == pytest.approx(baseline(measured), rel=1e-4)
    for place in OTHERS:
        depth = depth_at(out / "scene.ply", *place)
        assert depth == pytest.approx(truth(*place)[2], rel=0.03)


def inputs(views=2, height=40, width=60, sky=False, **known):
    images = torch.full((1, views, 3, height, width), 0.4)
    images[..., 20:, :] += 0.2 * torch.rand(1, views, 3, height - 20, width)
    if sky:
        images[:, :, :, :20] = torch.tensor([0.45, 0.65, 0.95])[:, None, None]
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1.5, 0.5], [0, 0, 1]])
    names = tuple("abc"[:views])
    photos = Views(images, lens.expand(1, views, 3, 3), names)
    return Inputs(photos, photos, **known)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("1:10,10,1:50,10", "expected [N:]X,Y,[N:]X,Y=LENGTH"),
        ("1:10,10=2m", "expected [N:]X,Y,[N:]X,Y=LENGTH"),
        ("1:10,10,1:50,10=2", "got the unit '', expected one of m, cm, mm, ft, in"),
        ("1:10,10,1:50,10=2 miles", "got the unit 'miles'"),
        ("1:10,10,1:50,10=0m", "a length must be a number above 0"),
        ("1:10,10,1:50,10=1.2.3m", "a length must be a number above 0"),
        ("1:10,10,1:10,10=2m", "both places are the same"),
        ("1:10,10,1:70,10=2m", "lies outside of what is used of photo 1"),
        ("1:10,10,3:50,10=2m", "on photo N (1 to 2)"),
    ],
)
def test_what_tells_no_length_is_one_sentence_before_work(text, told):
    with pytest.raises(InputError) as caught:
        with_known_length(inputs(), text)
    assert told in str(caught.value) and str(caught.value).startswith("--measure ")


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("m", 2), ("cm", 0.02), ("mm", 0.002), ("ft", 0.6096), ("in", 0.0508)],
)
def test_units_are_read(unit, metres):
    known = with_known_length(inputs(), f"10,10, 50,10 = 2 {unit}").length
    assert known.metres == pytest.approx(metres) and unit in METRES
    assert known.ends[1] == ("a", pytest.approx(50 / 60), pytest.approx(10 / 40))


def asked(text, unit=GIVEN, poses=None, **changed):
    """The scale by which a wall 2 before both cameras is measured; view b is 1 to the right."""
    given = inputs(unit=unit, **changed)
    if poses is not None:
        given = Inputs(
            photos=Views(
                given.photos.images, given.photos.intrinsics, ("a", "b"), poses
            ),
            start=given.start,
            unit=unit,
        )
    known = with_known_length(given, text)
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = 1
    cameras = Cameras(c2w, given.photos.intrinsics, given.photos.image_size)
    shape = (1, 2, 1, *given.photos.image_size)
    depths, alphas = torch.full(shape, 2.0), torch.ones(shape)
    alphas[..., :10, :10] = 0
    rendered = Rendering(given.photos.images, alphas, depths)
    made = SimpleNamespace(
        reconstruction=Reconstruction(None, cameras), cameras=cameras
    )
    return measure(known, known.length, made, rendered, False).scale


def test_two_places_may_be_on_two_photos():
    # x from -0.5 to 0.5 is 2 wide at depth 2, and photo b stands 1 to the right
    assert asked("1:0.25,0.5,1:0.75,0.5=1m") == pytest.approx(1, rel=1e-4)
    assert asked("1:0.25,0.5,2:0.75,0.5=1m") == pytest.approx(0.5, rel=1e-4)


def test_given_poses_are_scaled_with_the_scene():
    """They are in a unit of 4 of the run's."""
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, 1, 0, 3] = 1
    unit = Unit(torch.tensor([0.25], dtype=torch.float64))
    assert asked("1:0.25,0.5,1:0.75,0.5=1m", unit, poses) == pytest.approx(0.25, 1e-4)


def test_a_place_without_a_surface_is_named():
    with pytest.raises(InputError, match="the second place shows nothing that"):
        asked("1:30,30,1:4,4=1m")
    with pytest.raises(InputError, match="the first place shows the sky"):
        asked("1:30,5,1:30,30=1m", sky=True)


def test_a_given_scene_keeps_its_unit():
    with pytest.raises(InputError, match="a given scene keeps its unit"):
        with_known_length(inputs(scene=SimpleNamespace()), "1:1,1,1:9,9=1m")


def test_a_photo_that_is_left_out_tells_no_length():
    known = with_known_length(inputs(), "1:30,30,2:30,30=1m").select([0])
    shape = (1, 1, 1, 40, 60)
    rendered = Rendering(known.photos.images, torch.ones(shape), torch.ones(shape))
    cameras = Cameras(
        torch.eye(4)[None, None], known.photos.intrinsics, known.photos.image_size
    )
    made = SimpleNamespace(
        reconstruction=Reconstruction(None, cameras), cameras=cameras
    )
    with pytest.raises(InputError, match="second place is on b, which is no part"):
        measure(known, known.length, made, rendered, False)


def test_python_takes_the_same_words():
    with pytest.raises(InputError, match="--measure 1:2: expected"):
        edit3r.run(inputs().photos, editor="none", measure="1:2")
