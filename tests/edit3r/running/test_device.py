"""A run on another device than the CPU mixes the two nowhere, and finds the same."""

import pytest
import torch

import edit3r
from edit3r.kit.cache import Cache
from edit3r_testing import photograph, second_device

PHOTOS = photograph(3, (96, 128)).views  # three: fewer cannot tell what passed
MASKS = torch.ones(1, 3, 96, 128)


def run(prompt, **settings):
    return edit3r.run(PHOTOS, prompt, editor="recolor", masks=MASKS, **settings)


@pytest.fixture(scope="module")
def runs():
    """The second device, a run here, the same there, and the cache of that one."""
    plain = {"gaussians": "all", "refine": 0}  # choosing turns rounding into other ones
    here, cache = run("paint everything blue", **plain), Cache()
    with second_device() as device:
        plain |= {"device": str(device), "cache": cache}
        yield device, here, run("paint everything blue", **plain), cache


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:rasterizer 'auto' picked")
def test_a_run_there_finds_what_one_on_the_cpu_finds(runs):
    device, here, there, _ = runs
    assert there.gaussians.means.device == device
    apart = (there.rendered.images.cpu() - here.rendered.images).abs()
    # A Gaussian on the edge of being left out may go by rounding, which a few pixels show.
    assert (apart < 1e-5).float().mean() > 0.999 and apart.max() < 0.1


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:rasterizer 'auto' picked")
def test_a_run_there_uses_what_an_earlier_one_kept_and_is_saved(runs, tmp_path):
    device, _, _, cache = runs
    few = {"device": str(device), "cache": cache, "refine": 2, "frames": 2}
    again = run("paint everything red", **few)
    again.save(tmp_path / "run")
    assert "match" in cache.reused
    assert (tmp_path / "run" / "scene.ply").stat().st_size
