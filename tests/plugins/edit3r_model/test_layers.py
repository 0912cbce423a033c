import pytest
import torch
from edit3r_model.layers import Conv2d, GroupNorm
from torch import nn

from edit3r.kit.compute.layers import bilinear

THREADS = (1, 2, 4, 16)
MAKERS = (
    lambda: GroupNorm(8, 64),
    lambda: Conv2d(64, 3, 1),
    lambda: Conv2d(64, 64, 1),
    lambda: Conv2d(64, 8, 3, 1, 1),
)


@pytest.fixture
def on_threads():
    before = torch.get_num_threads()

    def on_threads(function):
        answers = []
        for count in THREADS:
            torch.set_num_threads(count)
            with torch.no_grad():
                answers.append(function())
        return answers

    yield on_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("order", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("shape", [(2, 64, 112, 160), (1, 64, 16, 12), (2, 64, 5, 8)])
def test_any_number_of_threads_gives_the_same_bits(on_threads, make, order, shape):
    torch.manual_seed(0)
    layer = make().to(memory_format=order)
    x = torch.randn(shape).contiguous(memory_format=order)
    first, *others = on_threads(lambda: layer(x))
    assert all(torch.equal(first, other) for other in others)
    assert first.is_contiguous(memory_format=order)


@pytest.mark.parametrize(
    ("size", "wished"), [((29, 43), (32, 48)), ((345, 512), (231, 343))]
)
def test_pictures_are_resized_to_the_same_bits_by_any_number_of_threads(
    on_threads, size, wished
):
    x = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0))
    first, *others = on_threads(lambda: bilinear(x, wished))
    assert all(torch.equal(first, other) for other in others)


def test_they_are_the_layers_of_torch():
    torch.manual_seed(0)
    x = torch.randn(1, 16, 9, 7)
    for ours, theirs in (
        (GroupNorm(8, 16), nn.GroupNorm(8, 16)),
        (Conv2d(16, 4, 1), nn.Conv2d(16, 4, 1)),
    ):
        theirs.load_state_dict(ours.state_dict())
        torch.testing.assert_close(ours(x), theirs(x))
