"""`edit3r simplify` and the two dials of a run."""

import pytest
import torch

from edit3r.cli.main import main
from edit3r.interfaces import Editor, Rasterizer, Reconstructor
from edit3r.io.cameras import posed_cameras, write_cameras
from edit3r.io.ply import load_ply, save_ply
from edit3r.pipeline import run
from edit3r.types import Reconstruction, Views

from .scenes import textured


@pytest.fixture
def scene_file(tmp_path):
    gaussians, cameras, _ = textured()
    save_ply(tmp_path / "scene.ply", gaussians)
    write_cameras(tmp_path / "cameras.json", posed_cameras(cameras, ["a.png", "b.png"]))
    return tmp_path / "scene.ply"


def test_a_file_becomes_a_smaller_file_of_the_same_views(scene_file, capsys):
    out = scene_file.parent / "small.ply"
    assert main(["simplify", str(scene_file), "--gaussians", "700", "--rasterizer", "numba", "--out", str(out)]) == 0
    assert 630 <= load_ply(out).count <= 700
    assert load_ply(out).view_index.unique().tolist() == [0, 1]
    assert out.stat().st_size < scene_file.stat().st_size / 3
    assert "6,144 Gaussians -> " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--cameras", "nowhere.json"], "nowhere.json: no such camera file; say where to look from with --cameras"),
        (["--gaussians", "few"], "--gaussians: expected auto, all or a number of at least 1, got 'few'."),
        (["--gaussians", "all"], "--gaussians all: nothing to do"),
        (["--set", "simplify.prices=1"], "simplify.prices: unknown setting. Did you mean 'price'?"),
        (["--set", "rasterizer.near=1"], "--set rasterizer: simplify has settings of its own only"),
    ],
)
def test_wrong_use_is_one_sentence(scene_file, capsys, arguments, said):
    out = scene_file.parent / "small.ply"
    assert main(["simplify", str(scene_file), *arguments, "--out", str(out)]) == 2
    assert said in capsys.readouterr().err and not out.exists()


class Keep(Editor):
    def edit(self, views, request):
        return views


class Darken(Editor):
    def edit(self, views, request):
        return Views(views.images * 0.5, views.intrinsics, views.names)


class Known(Reconstructor):
    """Answers with the true surfaces, whatever the photos show."""

    def __call__(self, views, source=None):
        gaussians, cameras, _ = textured()
        return Reconstruction(gaussians, cameras)


@pytest.fixture
def views():
    _, cameras, photos = textured()
    return Views(photos, cameras.intrinsics)


def test_a_run_leaves_what_was_asked_for_and_tells_the_harm(views, rasterizer):
    result = run(views, editor=Keep(), recon=Known(), rasterizer=rasterizer, gaussians=900, refine=2)
    notes = result.report.notes
    assert result.gaussians.count == notes["simplify.left"] <= 900 < notes["simplify.before"]
    assert notes["simplify.psnr_of_input_views_against_all"] > 15
    assert 0 <= notes["refine"]["steps"] <= 2
    assert [stage.name for stage in result.report.stages][-2:] == ["simplify", "refine"]


def test_a_limit_holds_whatever_was_wished(views, rasterizer):
    result = run(views, editor=Keep(), recon=Known(), rasterizer=rasterizer, gaussians="auto", max_gaussians=150)
    assert result.gaussians.count <= 150


def test_a_limit_above_what_there_is_changes_nothing(views, rasterizer):
    result = run(views, editor=Keep(), recon=Known(), rasterizer=rasterizer, max_gaussians=10**6)
    assert torch.equal(result.gaussians.means, textured()[0].means)


def test_a_run_keeps_everything_unless_asked(views):
    result = run(views, editor=Keep(), recon=Known(), rasterizer="no such rasterizer")
    assert result.gaussians.count == 2 * 48 * 64
    assert not any(key.startswith(("simplify", "refine")) for key in result.report.notes)


class Watch(Rasterizer):
    """Counts the cameras of every call."""

    def __init__(self, rasterizer):
        self.rasterizer, self.seen = rasterizer, []

    def render(self, gaussians, cameras):
        self.seen.append(cameras.count)
        return self.rasterizer.render(gaussians, cameras)


@pytest.mark.parametrize(("edit_views", "followed"), [("first", 1), ("all", 2)])
def test_refinement_follows_edited_photos_only(views, rasterizer, edit_views, followed):
    """Photos that still show the colours from before would pull them back."""
    watch = Watch(rasterizer)
    result = run(views, editor=Darken(), recon=Known(), rasterizer=watch, edit_views=edit_views, refine=2)
    assert result.report.notes["refine"]["steps"] > 0
    assert set(watch.seen) == {followed}
