"""A scene in place of photos: any format that is read, edited and written again as it came."""

import json
from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import (
    InputError,
    PromptError,
    QuestionError,
    SettingsError,
)
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.types import Views
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.scenes.ply import save_ply
from edit3r.kit.scenes.reading import load_scene
from edit3r.kit.scenes.scene_views import BACKGROUND, look_around
from edit3r.running.scene_input import make_scene_input
from tests.plugins.scan import of_ball, scan

QUICK = {"size": 48, "views": 4, "outputs": ("scene",)}


def red(views):
    """Masks of the red ball on pictures of the scan."""
    r, g, b = views.images.unbind(2)
    return ((r > 1.8 * g) & (r > 1.8 * b)).float()


def masks_of(scene, **settings):
    """The red ball on the pictures that a run of these settings takes."""
    chosen = {**QUICK, **settings}
    looked = edit3r.run(scene, editor="none", **chosen)
    return red(looked.photos)


def painted(scene, **settings):
    chosen = {**QUICK, **settings}
    masks = masks_of(scene, **settings)
    return edit3r.run(scene, "paint the ball blue", masks=masks, **chosen)


def test_an_edit_from_python_keeps_all_bits_but_the_colours_of_the_thing():
    # In another unit, far from the origin: the way there and back must cost nothing.
    made = scan(degree=1)
    given = replace(made, means=30 * made.means + 100, scales=30 * made.scales)
    result = painted(given)
    edited = result.scene
    for name in ("means", "scales", "quats", "opacities"):
        assert torch.equal(getattr(edited, name), getattr(given, name))
    changed = (edited.harmonics != given.harmonics).flatten(2).any(2)[0]
    assert changed[of_ball(given, 0)].float().mean() > 0.9
    assert not changed[of_ball(given, 1)].any()
    colours = 0.5 + 0.28209479 * edited.harmonics[0, of_ball(given, 0), 0]
    red, _, blue = colours.mean(0)
    assert blue > 2 * red
    noted = result.report.notes["scene.changed"]
    assert noted["gaussians"] == int(changed.sum())
    assert noted["mean_change"] > 0.1


def test_nothing_is_changed_where_nothing_is_edited(tmp_path):
    save_ply(tmp_path / "scan.ply", scan(), comment_lines=["of another program"])
    edit3r.run(tmp_path / "scan.ply", editor="none", **QUICK).save(tmp_path / "out")
    before, after = tmp_path / "scan.ply", tmp_path / "out" / "scene.ply"
    assert after.read_bytes() == before.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("writer", "name", "exact"),
    [
        ("ply", "scene.ply", True),
        ("spz", "scene.spz", True),
        ("splat", "scene.splat", True),
        ("glb", "scene.glb", True),
        ("compressed-ply", "scene.compressed.ply", False),
        ("spz4", "scene.spz", False),
        ("sog", "scene.sog", False),
    ],
)
def test_a_scene_is_written_in_the_format_it_came_in(tmp_path, writer, name, exact):
    made = edit3r.build("writer", writer)
    file = tmp_path / f"scan{made.offer.component.suffix}"
    made.write(file, SceneToWrite(scan()))
    before = load_scene(file)
    painted(file).save(tmp_path / "out")
    assert (tmp_path / "out" / name).is_file()
    after = load_scene(tmp_path / "out" / name)
    manifest = json.loads((tmp_path / "out" / "run.json").read_text())
    assert manifest["notes"]["scene.file"] == name
    assert after.count == before.count
    if exact:
        same = (after.harmonics == before.harmonics).flatten(2).all(2)[0]
        assert int((~same).sum()) <= manifest["notes"]["scene.changed"]["gaussians"]
        for field in ("means", "scales", "quats", "opacities"):
            assert torch.equal(getattr(after, field), getattr(before, field))
    nearest = torch.cdist(after.means[0], scan().means[0]).argmin(1)
    ball = of_ball(scan(), 0)[nearest]
    colours = (0.5 + 0.28209479 * after.harmonics[0, :, 0]).clamp(0, 1)
    assert colours[ball, 2].mean() > 2 * colours[ball, 0].mean()
    assert colours[of_ball(scan(), 1)[nearest], 1].mean() > 0.6


def test_what_is_removed_is_gone_from_the_file_and_the_rest_has_its_bits(tmp_path):
    file = tmp_path / "scan.ply"
    save_ply(file, scan(degree=1))
    masks = masks_of(file)
    result = edit3r.run(file, "remove the ball", masks=masks, editor="retouch", **QUICK)
    result.save(tmp_path / "out")
    before, after = load_scene(file), load_scene(tmp_path / "out" / "scene.ply")
    removed = result.report.notes["scene.removed"]["gaussians"]
    assert removed > 270
    kept = before.count - removed
    places = torch.cdist(after.means[0, :kept], before.means[0]).argmin(1)
    assert not of_ball(before, 0)[places].float().mean() > 0.02
    assert torch.equal(after.harmonics[0, :kept], before.harmonics[0, places])


def test_cameras_beside_a_scene_are_used_and_come_back_in_its_own_frame(tmp_path):
    save_ply(tmp_path / "scan.ply", scan())
    rasterizer = edit3r.build("rasterizer", "numba")
    cameras = look_around(scan(), rasterizer, count=3, size=(30, 40)).cameras
    write_cameras(
        tmp_path / "cameras.json", posed_cameras(cameras, ["a.png", "b.png", "c.png"])
    )
    result = edit3r.run(tmp_path / "scan.ply", editor="none", **QUICK)
    assert result.photos.names == ("a", "b", "c")
    assert result.photos.image_size == (30, 40)
    result.save(tmp_path / "out")
    told = json.loads((tmp_path / "out" / "cameras.json").read_text())
    for one, pose in zip(told, cameras.c2w[0]):
        assert torch.allclose(torch.tensor(one["c2w"]), pose, atol=1e-5)


def test_a_camera_that_sees_nothing_of_the_scene_is_left_out_with_its_name(tmp_path):
    save_ply(tmp_path / "scan.ply", scan())
    rasterizer = edit3r.build("rasterizer", "numba")
    cameras = look_around(scan(), rasterizer, count=3, size=(30, 40)).cameras
    cameras.c2w[0, 1, :3, [0, 2]] *= -1  # looks away
    names = ["a.png", "b.png", "c.png"]
    write_cameras(tmp_path / "cameras.json", posed_cameras(cameras, names))
    assert make_scene_input(tmp_path / "scan.ply", rasterizer).places.names == (
        "a",
        "c",
    )


def test_a_region_marked_on_a_picture_is_edited_from_the_command_line(tmp_path, capsys):
    save_ply(tmp_path / "scan.ply", scan())
    out = tmp_path / "out"
    words = ["run", str(tmp_path / "scan.ply"), "--prompt", "paint it blue"]
    marks = ["--region", "1:0.3,0.3,0.3,0.3", "--size", "48", "--views", "4"]
    assert main([*words, *marks, "--out", str(out), "--outputs", "scene"]) == 0
    said = capsys.readouterr().out
    assert f"scene        {out / 'scene.ply'}" in said and ".;" not in said
    changed = json.loads((out / "run.json").read_text())["notes"]["scene.changed"]
    assert 0 < changed["gaussians"] < scan().count


def test_a_preview_without_a_prompt_shows_the_places(tmp_path):
    save_ply(tmp_path / "scan.ply", scan())
    sheet = tmp_path / "places.png"
    words = ["run", str(tmp_path / "scan.ply"), "--preview", str(sheet)]
    assert main([*words, "--size", "48", "--views", "4"]) == 0
    assert sheet.is_file()


def refused(tmp_path, content, *more):
    """What the command says of a scene file, and that it leaves nothing."""
    file = tmp_path / "scene.ply"
    if isinstance(content, bytes):
        file.write_bytes(content)
    else:
        save_ply(file, content)
    out = tmp_path / "out"
    with pytest.raises((InputError, SettingsError)) as error:
        edit3r.run(file, "paint it blue", **{**QUICK, **dict(more)}).save(out)
    assert not out.exists()
    return str(error.value)


def test_what_is_no_scene_ends_in_a_sentence_and_leaves_nothing(tmp_path):
    mesh = (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nend_header\n0 0 0\n"
    )
    assert "does not hold 3D Gaussians" in refused(tmp_path, mesh)
    faint = replace(scan(), opacities=torch.full_like(scan().opacities, 1e-4))
    assert "shows nothing" in refused(tmp_path, faint)
    assert "single point" in refused(tmp_path, scan().select(torch.tensor([0])))
    assert "cannot go on from one" in refused(tmp_path, scan(), ("recon", "edit3r"))


def test_a_click_on_nothing_is_refused(tmp_path):
    save_ply(tmp_path / "scan.ply", scan())
    corner = edit3r.Selection(positive=((0, 0.02, 0.02),))
    with pytest.raises(InputError, match="on nothing"):
        edit3r.run(tmp_path / "scan.ply", "paint it blue", masks=corner, **QUICK)


def test_a_scene_among_photos_is_refused(tmp_path):
    with pytest.raises(InputError, match="edited alone"):
        edit3r.run([tmp_path / "a.ply", tmp_path / "b.jpg"], "paint it blue")


def test_a_scene_too_large_for_the_memory_says_what_it_takes(monkeypatch):
    monkeypatch.setattr("edit3r.running.scene_input.available_memory", lambda: 1000)
    with pytest.raises(InputError, match=r"need about .* GB.*edit3r simplify"):
        edit3r.run(scan(), editor="none", **QUICK)


def test_a_stranger_that_knows_no_scenes_is_refused_before_work():
    views = Views(torch.rand(1, 2, 3, 8, 8), torch.eye(3).expand(1, 2, 3, 3))
    with pytest.raises(InputError, match="splat file in place of photos"):
        edit3r.run(views, "paint it blue", recon="in-place")


def test_the_edited_scene_is_drawn_over_the_grey_that_its_pictures_have():
    result = edit3r.run(scan(), editor="none", **QUICK)
    empty = result.rendered.alphas[:, :, 0] == 0
    assert empty.any()
    drawn = result.rendered.images.movedim(2, 0)[:, empty]
    assert torch.equal(drawn, torch.full_like(drawn, BACKGROUND))


def test_words_are_looked_for_on_the_pictures_of_a_given_scene():
    """Of photos a word that nothing knows is asked about on the first one, before geometry is
    read; a given scene has it, and its selector answers for all pictures at once.
    """
    with pytest.raises(QuestionError, match="what is meant by 'zyzzyva'"):
        edit3r.run(scan(), "paint the zyzzyva blue", **QUICK)
    result = edit3r.run(scan(), "paint the zyzzyva blue", guess=True, **QUICK)
    assert result.selection_verdict.confidence < 0.5


def test_undo_of_a_given_scene_says_where_the_scene_before_is():
    with pytest.raises(PromptError, match=r"keeps no earlier edit; .* run\.json names"):
        edit3r.run(scan(), "undo", **QUICK)
