"""What the caller has set in torch: everything works inside, and is left as it was."""

import contextlib

import pytest
import torch

import edit3r
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.scenes.reading import load_scene


@contextlib.contextmanager
def default_dtype(dtype):
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    yield
    torch.set_default_dtype(before)


@contextlib.contextmanager
def default_device(device):
    torch.set_default_device(device)
    yield
    torch.set_default_device(None)


STATES = {
    "float64": lambda: default_dtype(torch.float64),
    "bfloat16": lambda: default_dtype(torch.bfloat16),
    "float16": lambda: default_dtype(torch.float16),
    "inference": torch.inference_mode,
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "no_grad": torch.no_grad,
    "default device": lambda: default_device("meta"),
    "device context": lambda: torch.device("meta"),
}


def state():
    return (
        torch.get_default_dtype(),
        torch.is_inference_mode_enabled(),
        torch.is_autocast_enabled("cpu"),
        torch.is_grad_enabled(),
        torch.get_default_device(),
    )


@pytest.fixture(params=STATES.values(), ids=STATES)
def inside(request):
    with request.param():
        before = state()
        yield
        assert state() == before


def tiny(device="cpu"):
    own = {"dtype": torch.float32, "device": device}
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]], **own)
    scene = Gaussians(
        torch.tensor([[[0.0, 0, 4], [0.2, 0.1, 5]]], **own),
        torch.full((1, 2, 3), 0.2, **own),
        torch.tensor([1.0, 0, 0, 0], **own).expand(1, 2, 4),
        torch.full((1, 2), 0.8, **own),
        torch.full((1, 2, 4, 3), 0.1, **own),
        view_index=torch.tensor([-1, -1], device=device),
    )
    return scene, Cameras(torch.eye(4, **own)[None, None], lens[None, None], (32, 32))


@pytest.mark.parametrize("name", ["torch", "numba"])
def test_render_draws_the_same(inside, name):
    found = edit3r.build("rasterizer", name).render(*tiny()).images
    with torch.device("cpu"), torch.inference_mode(False):
        assert (found.dtype, found.device.type) == (torch.float32, "cpu")
        assert float(found.sum()) == pytest.approx(34.968, abs=0.01)


def test_scenes_and_photos_are_loaded_as_ever(inside, tmp_path):
    edit3r.save_ply(tmp_path / "s.ply", tiny()[0])
    for load in (edit3r.load_ply, load_scene):
        loaded = load(tmp_path / "s.ply")
        assert (loaded.means.dtype, loaded.means.device.type) == (torch.float32, "cpu")
    views = edit3r.load_views(packaged_pair()[0], size=32)
    assert (views.images.dtype, views.images.device.type) == (torch.float32, "cpu")
    assert not views.images.is_inference()


@pytest.fixture(scope="module")
def usual():
    return made()


def made():
    photos, cameras = packaged_pair()
    kept = {"size": 64, "frames": 2, "refine": 1, "outputs": ["sheet"]}
    return edit3r.run(
        edit3r.load_views(photos, size=64, cameras=cameras),
        "paint it blue",
        editor="recolor",
        masks=edit3r.Selection(positive=((0, 0.5, 0.4),)),
        **kept,
    )


@pytest.mark.slow
def test_a_run_gives_the_same_scene(usual, inside, tmp_path):
    result = made()
    result.save(tmp_path / "r")
    with torch.inference_mode(False), torch.device("cpu"):
        for name in ("means", "scales", "quats", "opacities", "harmonics"):
            assert torch.equal(
                getattr(result.gaussians, name), getattr(usual.gaussians, name)
            )


@pytest.mark.slow
def test_a_selection_is_the_same(inside):
    views = edit3r.load_views(packaged_pair()[0], size=64)
    found = edit3r.select(views, edit3r.Selection(positive=((0, 0.5, 0.4),)))
    assert found.masks.dtype == torch.float32 and not found.masks.is_inference()


def test_what_was_made_in_inference_mode_is_taken():
    with torch.inference_mode():
        scene, cameras = tiny()
    weights = edit3r.build("rasterizer", "torch").contributions(scene, cameras)
    assert weights.sum() > 0
