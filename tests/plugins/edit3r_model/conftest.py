import sys
from pathlib import Path

import pytest
import torch

# The independent calculation beside the tests.
sys.path.insert(0, str(Path(__file__).parent))

from noposplat_reference import Sizes, random_state

SMALL = Sizes(
    width=64,
    depth=2,
    heads=2,
    decoder_width=48,
    decoder_depth=10,
    decoder_heads=3,
    feature=16,
    point=12,
    layers=(8, 12, 16, 20),
)


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Threads cost such small networks more than they save."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def sizes() -> Sizes:
    return SMALL


@pytest.fixture(scope="session")
def official_state() -> dict[str, torch.Tensor]:
    """An official state dict (names without `encoder.`) of a small random network."""
    return random_state(SMALL, seed=0)


@pytest.fixture(scope="session")
def checkpoint(tmp_path_factory, official_state):
    """The same as a Lightning file."""
    path = tmp_path_factory.mktemp("weights") / "small.ckpt"
    state = {f"encoder.{key}": value for key, value in official_state.items()}
    torch.save({"epoch": 0, "state_dict": state, "loops": {}}, path)
    return path
