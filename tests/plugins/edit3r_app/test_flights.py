"""Flights along views that the user chose."""

from types import SimpleNamespace

import pytest
import torch
from edit3r_app import flights
from edit3r_app.flights import PER_LEG, film, path_along, read_keys
from edit3r_app.jobs import JobsFolder

from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras
from edit3r.loading.registry import default_registry

EYE = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
KEY = {"r": EYE, "t": [0, 0, 0], "K": [0.9, 1.2, 0.5, 0.5], "zoom": 1}


def test_a_flight_passes_every_view_and_rests_at_its_ends():
    aside = {"r": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "t": [1, 0, 0]}
    aside["K"] = [1.1, 1.4, 0.45, 0.52]
    keys = read_keys([KEY, aside, {**KEY, "t": [1, 0, 2]}])
    path = path_along(keys, (60, 80))
    assert isinstance(path, Cameras) and path.count == 2 * PER_LEG + 1
    places = path.c2w[0, :, :3, 3]
    for step, key in ((0, keys[0]), (PER_LEG, keys[1]), (2 * PER_LEG, keys[2])):
        assert torch.allclose(places[step], torch.tensor(key.t).float(), atol=1e-5)
        axes = torch.tensor(key.r).float().T  # right, down and forward are columns
        assert torch.allclose(path.c2w[0, step, :3, :3], axes, atol=1e-5)
        fx, fy, cx, cy = key.K
        lens = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        assert torch.allclose(path.intrinsics[0, step], lens)
    paces = (places[1:] - places[:-1]).norm(dim=-1)
    assert paces[0] < 0.1 * paces[PER_LEG // 2]
    assert torch.allclose(path.intrinsics[0, PER_LEG // 2, 0, 0], torch.tensor(1.0))


def test_axes_of_a_viewer_that_are_nearly_right_become_a_rotation():
    leaning = {**KEY, "r": [[1.001, 0, 0], [0, 0.999, 0], [0, 0.001, 1]]}
    key = read_keys([leaning, KEY])
    turned = key[0].c2w[:3, :3]
    assert torch.allclose(turned @ turned.T, torch.eye(3).double(), atol=1e-9)
    assert turned.trace() > 2.99


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (None, "not views"),
        ([KEY], "expected 2 to 12"),
        ([{**KEY, "t": [1, 0, 0]}, KEY, KEY], "view 3 is where view 2 is"),
        ([KEY] * 13, "expected 2 to 12"),
        ([{**KEY, "t": [0, 0]}] * 2, "not views"),
        ([{**KEY, "K": [0, 1, 0.5, 0.5]}] * 2, "not views"),
        ([{**KEY, "r": [[0, 0, 0]] * 3}] * 2, "not views"),
        ([{**KEY, "r": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}] * 2, "not views"),
        ([{**KEY, "t": [float("nan"), 0, 0]}] * 2, "not views"),
    ],
)
def test_what_is_no_flight_is_refused(asked, told):
    with pytest.raises(InputError, match=told):
        read_keys(asked)


class Drawn:
    """A registry that draws nothing, and notes which writer wrote."""

    def __init__(self, lacks):
        self.lacks, self.used = lacks, []

    def find(self, kind, name):
        return name

    def missing(self, offer):
        return ["av"] if offer in self.lacks else []

    def build(self, kind, name):
        self.used.append(name)
        return SimpleNamespace(write=lambda path, scene: path.write_bytes(b"film"))


@pytest.mark.parametrize(
    ("plays_mp4", "lacks", "name"),
    [
        (True, [], "flight.mp4"),
        (False, [], "flight.webm"),
        (True, ["mp4"], "flight.webm"),
    ],
)
def test_a_film_is_mp4_where_the_browser_plays_it(
    plays_mp4, lacks, name, tmp_path, monkeypatch
):
    (tmp_path / "jar").mkdir()
    (tmp_path / "jar" / "scene.ply").touch()
    shown = SimpleNamespace(gaussians=None, cameras=SimpleNamespace(image_size=(8, 8)))
    monkeypatch.setattr(flights, "SavedScene", lambda *asked: shown)
    keys = [KEY, {**KEY, "t": [1, 0, 0]}]
    made = film(JobsFolder(tmp_path), "jar", keys, Drawn(lacks), plays_mp4=plays_mp4)
    assert made.name == name and made.read_bytes() == b"film"


def test_a_run_without_a_scene_is_told_so(tmp_path):
    (tmp_path / "jar").mkdir()
    with pytest.raises(InputError, match="no scene to fly through yet"):
        film(
            JobsFolder(tmp_path),
            "jar",
            [KEY, {**KEY, "t": [1, 0, 0]}],
            default_registry(),
        )
