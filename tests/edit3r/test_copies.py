"""What a run gives travels: copied, pickled, handed to another process."""

import copy
import pickle

import pytest
import torch

import edit3r
from edit3r.kit.photos.images import packaged_pair

KEPT = {"size": 64, "frames": 2, "refine": 1, "outputs": ["sheet"]}


def red(**more):
    mark = edit3r.Selection(positive=((0, 0.5, 0.4),))
    return edit3r.run(
        prompt="paint it red", editor="recolor", masks=mark, **KEPT, **more
    )


@pytest.fixture(scope="module")
def result():
    return red(photos=packaged_pair()[0], cache=edit3r.Cache(), progress=True)


def through_pickle(value):
    return pickle.loads(pickle.dumps(value))


@pytest.mark.slow
def test_a_result_can_be_copied_saved_and_edited_again(result, tmp_path):
    other = copy.copy(result)
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        assert torch.equal(
            getattr(other.gaussians, name), getattr(result.gaussians, name)
        )
    assert other.verdict == result.verdict and other.config == result.config
    assert (other.save(tmp_path / "r") / "run.json").is_file()
    assert red(earlier=other).gaussians.count > 0


@pytest.mark.slow
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, through_pickle])
@pytest.mark.parametrize(
    "part",
    ["gaussians", "cameras", "photos", "verdict", "config", "cache", "report"],
)
def test_so_can_its_parts(result, part, copied):
    copied(getattr(result, part))
