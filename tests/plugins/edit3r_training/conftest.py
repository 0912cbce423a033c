import pytest
import torch


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Threads cost such small networks more than they save."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
