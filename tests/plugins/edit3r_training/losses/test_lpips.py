"""The lpips loss, with a package in lpips's place: the real one needs torchvision and a downloaded backbone."""

import sys

import pytest
import torch

import edit3r
from edit3r.errors import MissingDependencyError
from edit3r.interfaces import LossInputs

PACKAGE = '''
import torch


class LPIPS(torch.nn.Module):
    """The call of lpips.LPIPS; the distance of pictures in [-1, 1] is their mean squared difference."""

    def __init__(self, net, verbose):
        super().__init__()
        assert net == "vgg"
        {raises}

    def forward(self, first, second, normalize=False):
        if normalize:
            first, second = 2 * first - 1, 2 * second - 1
        return (first - second).square().mean((1, 2, 3), keepdim=True)
'''


@pytest.fixture
def install(tmp_path, monkeypatch):
    def install(raises: str = "") -> None:
        (tmp_path / "lpips").mkdir()
        (tmp_path / "lpips" / "__init__.py").write_text(PACKAGE.format(raises=raises))
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.delitem(sys.modules, "lpips", raising=False)

    yield install
    sys.modules.pop("lpips", None)


def test_pictures_are_handed_over_in_the_range_lpips_expects_and_averaged(install):
    install()
    rendered, target = torch.rand(2, 2, 2, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    value = edit3r.build("loss", "lpips")(LossInputs(rendered=rendered, target=target))
    assert torch.isclose(value, 4 * (rendered - target).square().mean())
    assert edit3r.build("loss", "lpips")(LossInputs(rendered=target, target=target)) == 0


def test_a_backbone_that_cannot_be_downloaded_is_a_sentence(install):
    install(raises="raise OSError('no network')")
    with pytest.raises(MissingDependencyError, match=r"VGG weights \(no network\).*'perceptual', which works offline"):
        edit3r.build("loss", "lpips")


def test_without_the_package_the_install_command_is_named(monkeypatch):
    monkeypatch.setattr("edit3r.registry._installed", lambda module: module != "lpips")
    with pytest.raises(MissingDependencyError, match=r'pip install "edit3r\[lpips\]"'):
        edit3r.build("loss", "lpips")
