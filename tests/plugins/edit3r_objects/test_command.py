"""`edit3r objects` on a run: what it says, writes, refuses, and never touches."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import edit3r_objects.run
import numpy as np
import pytest
import torch
from edit3r_objects.finding import Finders
from PIL import Image

import edit3r
from edit3r.cli.main import main
from edit3r.contract.interfaces import MaskLogits, SceneToWrite, Segmenter
from edit3r.contract.types import Gaussians
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.scenes.ply import load_ply, save_ply
from edit3r.kit.scenes.reading import load_scene
from edit3r.running import RunFolder, usual_selector
from edit3r_testing import CommandContract
from tests.plugins.scan import scan

FLAT = Path(__file__).parents[1] / "flat_scene.py"


class TestObjects(CommandContract):
    component = "objects"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with photos, a mask of their left half, a run, and the run with an object."""
    place = tmp_path_factory.mktemp("objects")
    for name, photo in zip("ab", packaged_pair()[0]):
        Image.open(photo).resize((48, 32)).save(place / f"{name}.png")
    half = np.zeros((32, 48), np.uint8)
    half[:, :24] = 255
    for name in "ab":
        Image.fromarray(half).save(place / f"{name}_mask.png")
    settings = "editor=none reconstructor=flat refine=0 gaussians=all size=48"
    given = [f"--set={one}" for one in f"{settings} outputs=scene,images".split()]
    photos = [str(place / "a.png"), str(place / "b.png")]
    plugin = ["--plugin", str(FLAT), "--quiet", "--out", str(place / "run")]
    assert main(["run", *photos, *given, *plugin]) == 0
    add = f"add left --mask {place}/a_mask.png {place}/b_mask.png"
    assert objects(place, f"run {add} --out {place}/left") == 0
    return place


def objects(place, line):
    """The command, with the run's folder first."""
    return main(["objects", f"{place}/{line.split()[0]}", *line.split()[1:], "--quiet"])


def scene_of(folder):
    return load_ply(folder / "scene.ply")


def manifest_of(folder):
    return json.loads((folder / "run.json").read_text())


def test_a_mask_becomes_an_object_that_is_listed(made, capsys):
    share = (scene_of(made / "left").object_index == 0).float().mean()
    assert 0.3 < share < 0.6  # half of what shows, not the edge
    assert objects(made, "left") == 0
    said = capsys.readouterr().out
    assert said.startswith("left: ") and "seen in a, b" in said
    assert objects(made, "run") == 0
    assert "no objects; make one" in capsys.readouterr().out


def test_removing_and_isolating_part_the_scene(made, capsys):
    line = f"objects {made}/left remove left --out {made}/without"
    assert main(line.split()) == 0
    guessed = manifest_of(made / "without")["object_guesses"]
    assert f"{guessed:,} Gaussians are guesses" in capsys.readouterr().out
    assert objects(made, f"left isolate left --out {made}/only") == 0
    whole = scene_of(made / "left").count
    left = scene_of(made / "without").count - guessed
    only = scene_of(made / "only").count
    assert 0.9 * whole < left + only <= whole  # the rim goes with the object
    assert only == (scene_of(made / "left").object_index == 0).sum()
    assert manifest_of(made / "without")["objects"] == {}
    assert (made / "without" / "before_after.png").is_file()


def test_a_true_length_scales_the_scene_and_what_goes_on_from_it(made):
    """Photos stay, since it looks as before; told again, the last length counts."""
    run = made / "apart"
    shutil.copytree(made / "run", run)
    content = json.loads((run / "cameras.json").read_text())
    content[1]["c2w"][0][3] = 0.5
    (run / "cameras.json").write_text(json.dumps(content))
    before = scene_of(run)
    assert objects(made, f"apart measure 4=200cm --out {made}/half") == 0
    assert objects(made, f"half measure 2=4m --out {made}/whole") == 0
    for name, factor in (("half", 0.5), ("whole", 1.0)):
        scene, facts = scene_of(made / name), manifest_of(made / name)
        torch.testing.assert_close(scene.means, factor * before.means)
        torch.testing.assert_close(scene.scales, factor * before.scales)
        assert facts["frame"].endswith("in metres")
        assert facts["notes"]["scale"] == pytest.approx(factor)
        cameras = json.loads((made / name / "cameras.json").read_text())
        assert cameras[1]["c2w"][0][3] == pytest.approx(0.5 * factor)
        assert (made / name / "inputs").is_dir()
        earlier = RunFolder(made / name).read().inputs
        torch.testing.assert_close(earlier.before.gaussians.means, before.means)
    assert '"unit": "m"' in (made / "half" / "viewer.html").read_text()


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ("", "measure: give a length of the scene and the true one"),
        ("1.2m", "expected a length of the scene, and how long it is in truth"),
        ("0=1m", "expected a length of the scene, and how long it is in truth"),
        ("nan=1m", "expected a length of the scene, and how long it is in truth"),
        ("3=1", "got the unit '', expected one of m, cm, mm, ft, in"),
        ("3=0m", "a length must be a number above 0"),
    ],
)
def test_what_is_no_length_is_refused(made, capsys, told, says):
    assert objects(made, f"run measure {told} --out {made}/none") == 2
    assert says in capsys.readouterr().err
    assert not (made / "none").exists()


def test_a_scene_that_was_given_keeps_its_unit(made, capsys):
    shutil.copy(made / "run" / "scene.ply", made / "scan.ply")
    assert objects(made, f"scan.ply measure 3=1m --out {made}/none") == 2
    assert "a given scene keeps its unit" in capsys.readouterr().err


class Half(Segmenter):
    """Whatever is clicked on is a part of the left half."""

    def __init__(self):
        pass

    def masks(self, image, clicks, box=None, before=None):
        logits = torch.full_like(image[:1], -4)
        logits[:, 6:26, 4:20] = 4
        return MaskLogits(logits)


def test_things_are_found_by_one_press(made, monkeypatch, capsys):
    monkeypatch.setattr(
        edit3r_objects.run, "usual_tools", lambda: Finders(usual_selector(Half()), None)
    )
    assert objects(made, f"run find --out {made}/found") == 0
    assert manifest_of(made / "found")["objects"] == {"thing 1": 0}
    share = (scene_of(made / "found").object_index == 0).float().mean()
    assert 0.1 < share < 0.3  # of the pixels 0.21
    assert objects(made, f"left find --out {made}/more") == 0  # it is an object already
    assert manifest_of(made / "more")["objects"] == {"left": 0}
    assert objects(made, f"run find it --out {made}/no") == 2
    assert "find takes no name" in capsys.readouterr().err


def test_links_among_the_photos_are_not_followed(made):
    run = made / "linked"
    shutil.copytree(made / "run", run)
    (made / "secret.txt").write_text("secret")
    (run / "inputs" / "more.png").symlink_to(made / "secret.txt")
    mask = f"--mask {made}/a_mask.png {made}/b_mask.png"
    assert objects(made, f"linked add left {mask} --out {made}/apart") in (0, 2)
    for path in (made / "apart").rglob("*"):
        assert path.is_symlink() or path.is_dir() or b"secret" not in path.read_bytes()


def test_edits_follow_each_other_and_are_written_down(made):
    before = (made / "left" / "scene.ply").read_bytes()
    assert objects(made, f"left rename left door --out {made}/named") == 0
    assert objects(made, f"named copy door twin 0.5 0 0 --out {made}/two") == 0
    assert objects(made, f"two recolor twin dark green --out {made}/green") == 0
    page = (made / "green" / "viewer.html").read_text("utf-8")
    assert '"named": ["door", "twin"]' in page
    facts = manifest_of(made / "green")
    assert facts["objects"] == {"door": 0, "twin": 1}
    assert facts["object_edits"][1:] == [
        "rename left door",
        "copy door twin 0.5 0 0",
        "recolor twin dark green",
    ]
    assert facts["edited_from"] == str(made / "two")
    scene = scene_of(made / "green")
    door, twin = (scene.select(scene.object_index == index) for index in (0, 1))
    shift = (twin.means - door.means)[0]
    torch.testing.assert_close(shift, torch.tensor([[0.5, 0, 0]]).expand_as(shift))
    assert not torch.equal(twin.harmonics, door.harmonics)
    assert (made / "left" / "scene.ply").read_bytes() == before


def test_an_edited_scene_takes_no_new_marks_of_its_old_photos(made, capsys):
    assert objects(made, f"left move left 0.1 0 0 --out {made}/moved") == 0
    assert objects(made, f"moved add other --out {made}/no") == 2
    assert "has no photos to mark the object on" in capsys.readouterr().err
    assert not (made / "no").exists()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("left remove right --out {0}/no", "has no object 'right'; it has left"),
        ("left add left --out {0}/no", "already has an object 'left'"),
        ("left copy left left 0 0 0 --out {0}/no", "already has an object 'left'"),
        ("left add other --out {0}/no", "kept no masks; mark the object with"),
        ("left move left 0.1 nan 0 --out {0}/no", "expected numbers from -1000"),
        ("left move left 0.1 0 --out {0}/no", "expected edit3r objects RUN move NAME"),
        ("left turn left far --out {0}/no", "expected numbers"),
        ("left scale left 0 --out {0}/no", "expected a factor"),
        ("left recolor left quickly --out {0}/no", "quickly"),
        ("left recolor left red and the cup blue --out {0}/no", "expected one colour"),
        ("left remove left", "give --out a folder"),
        ("left remove left --out {0}/left", "would overwrite a file that is read"),
        ("nowhere remove left --out {0}/no", "no such file"),
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_is_written(made, line, said, capsys):
    assert objects(made, line.format(made)) == 2
    assert said in capsys.readouterr().err
    assert not (made / "no").exists()


@pytest.mark.parametrize(
    "names", [{"left": -1}, {"left": 2**70}, {"\x1b[31mleft": 0}, {"left": "x"}, [0]]
)
def test_a_strangers_list_of_objects_is_read_with_care(made, names, capsys):
    run = made / "strange"
    shutil.rmtree(run, ignore_errors=True)
    shutil.copytree(made / "left", run)
    facts = {**manifest_of(run), "objects": names}
    (run / "run.json").write_text(json.dumps(facts))
    assert objects(made, "strange") == 2
    said = capsys.readouterr().err
    assert "run.json: cannot be read" in said and "\x1b" not in said


@pytest.mark.parametrize(
    "line", ["recolor ghost red", "isolate ghost", "scale ghost 2"]
)
def test_nothing_is_done_to_an_object_of_which_nothing_is_left(made, line, capsys):
    run = made / "ghostly"
    shutil.rmtree(run, ignore_errors=True)
    shutil.copytree(made / "left", run)
    facts = manifest_of(run)
    facts["objects"] = {**facts["objects"], "ghost": 99}
    (run / "run.json").write_text(json.dumps(facts))
    assert objects(made, f"ghostly {line} --out {made / 'no'}") == 2
    assert "ghost: none of its Gaussians is left" in capsys.readouterr().err
    assert not (made / "no").exists()


@pytest.mark.parametrize("form", ["spz", "glb", "ply"])
def test_a_scene_from_elsewhere_is_listed_without_run_or_cameras(
    made, tmp_path, form, capsys
):
    if form == "spz":
        pytest.importorskip("gaussforge", reason="needs the extra export")
    file = tmp_path / "theirs.bin"
    line = ["export", str(made / "run"), "--to", form, "--out", str(file), "--quiet"]
    assert main(line) == 0 and main(["objects", str(file)]) == 0
    assert "no objects" in capsys.readouterr().out


def drawn_file(place, name, begin, end, **more):
    """A lasso around a part of what the first camera shows, from its left to its right edge."""
    camera = json.loads((place / "run" / "cameras.json").read_text())[0]
    c2w = np.array(camera["c2w"])
    (fx, _, cx), (_, fy, cy), _ = camera["K"]
    stroke = {
        "kind": "lasso",
        "places": [(begin, 0), (end, 0), (end, 1), (begin, 1)],
        **dict(zip(("right", "down", "forward", "centre"), c2w[:3].T.tolist())),
        "lens": (fx / 48, fy / 32, cx / 48, cy / 32),
        "aspect": 1.5,
    }
    file = place / f"{name}.json"
    file.write_text(json.dumps({"strokes": [{**stroke, **more}]}))
    return file


def test_what_is_drawn_around_is_cut_kept_or_named(made):
    file = drawn_file(made, "half", 0, 0.5)
    for action, name in (("cut", ""), ("crop", ""), ("add", "drawn")):
        line = f"run {action} {name} --drawn {file} --out {made}/{action} --overwrite"
        assert objects(made, line) == 0
    whole, cut, crop = (scene_of(made / one) for one in ("run", "cut", "crop"))
    assert cut.count + crop.count == whole.count
    assert 0.3 < crop.count / whole.count < 0.7
    masked = scene_of(made / "left").objects >= 0
    drawn = scene_of(made / "add").objects >= 0
    shared = (masked & drawn).sum() / (masked | drawn).sum()
    assert shared > 0.9, "as by masks of the photos"
    assert list(manifest_of(made / "add")["objects"]) == ["drawn"]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("cut", "expected --drawn FILE"),
        ("cut it --drawn {file}", "takes no name"),
        ("remove it --drawn {file}", "remove does not take it"),
        ("cut --drawn {broken}", "expected JSON with strokes"),
        ("cut --drawn {flat}", "not a camera"),
        ("clean it", "takes no name"),
    ],
)
def test_what_cannot_be_drawn_is_told(made, capsys, line, told):
    (made / "broken.json").write_text("{}")
    flat = drawn_file(made, "flat", 0, 1, right=(0, 0, 1))
    files = {"file": drawn_file(made, "half", 0, 0.5), "broken": made / "broken.json"}
    line = line.format(**files, flat=flat)
    assert objects(made, f"run {line} --out {made}/nothing") == 2
    assert told in capsys.readouterr().err
    assert not (made / "nothing").exists()


def test_floaters_are_taken_out_and_a_clean_scene_is_told(made, capsys, tmp_path):
    assert objects(made, f"run clean --out {tmp_path}/none") == 2
    assert "no floaters" in capsys.readouterr().err
    dirty = tmp_path / "dirty"
    shutil.copytree(made / "run", dirty)
    scene = scene_of(dirty)
    spread = scene.select(torch.tensor([100, 700]))  # near the camera, thin as a veil
    near = replace(spread, means=0.3 * spread.means, scales=0.1 * spread.scales)
    near = replace(near, opacities=0.2 * spread.opacities)
    save_ply(dirty / "scene.ply", Gaussians.cat([scene, near]))
    line = ["objects", str(dirty), "clean", "--out", str(tmp_path / "clean"), "--quiet"]
    assert main(line) == 0
    assert scene.count <= scene_of(tmp_path / "clean").count < scene.count + 2


@pytest.mark.slow
def test_things_of_an_edited_splat_are_taken_hold_of(tmp_path):
    """Of whatever format it is, and wherever its own frame lies."""
    writer = edit3r.build("writer", "spz")
    writer.write(tmp_path / "scan.spz", SceneToWrite(scan(1)))
    quick = {"size": 48, "views": 4, "outputs": ("scene", "images")}
    looked = edit3r.run(tmp_path / "scan.spz", editor="none", **quick)
    red, green, blue = looked.photos.images.unbind(2)
    masks = ((red > 1.8 * green) & (red > 1.8 * blue)).float()
    made = edit3r.run(
        tmp_path / "scan.spz", "paint the ball blue", masks=masks, **quick
    )
    made.save(tmp_path / "run")
    # What two pictures show is carried to the others by the scene itself.
    files = [tmp_path / f"place_{k + 1}.png" for k in (0, 2)]
    for file, mask in zip(files, masks[0, ::2]):
        Image.fromarray((255 * mask).byte().numpy()).save(file)
    marks = f"--mask {' '.join(map(str, files))}"
    assert objects(tmp_path, f"run add ball {marks} --out {tmp_path}/add") == 0
    given = load_scene(tmp_path / "run" / "scene.spz")
    ball = scene_of(tmp_path / "add").object_index == 0
    assert ball[:300].float().mean() > 0.9 and not ball[300:600].any()
    assert torch.equal(scene_of(tmp_path / "add").means, given.means)

    def after(line, name):
        assert objects(tmp_path, f"add {line} --out {tmp_path}/{name}") == 0
        return scene_of(tmp_path / name)

    count = int(ball.sum())
    assert after("isolate ball", "only").count == count
    twice = after("copy ball twin 0 1 0", "twice")
    assert twice.count == given.count + count
    shift = (twice.means[0, -count:] - given.means[0, ball]).median(0).values
    assert shift[1] < -1 and shift[[0, 2]].abs().max() < 0.02  # y is down
    large = after("scale ball 2", "large")
    own = large.select(large.object_index == 0)
    assert float(own.scales.median() / given.scales[:, ball].median()) == pytest.approx(
        2, rel=0.05
    )
    moved = after("move ball 1 0 0", "moved")
    again = edit3r.run(earlier=tmp_path / "moved", editor="none", **quick)
    assert again.scene.count == moved.count
