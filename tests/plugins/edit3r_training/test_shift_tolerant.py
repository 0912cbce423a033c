"""Shift-tolerant LPIPS reads its package's file alone; with tiny weights, and the real ones where
they are installed.
"""

import importlib.util
import sys

import pytest
import torch
from edit3r_training.shift_tolerant import LAYERS, PACKAGE, _halved

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import LossInputs
from edit3r_testing import CONTRACTS, Contract, claims, contract_for

WIDTH = 4
SHIFTED, COARSE = 0.0284328, 0.517335  # by the package's own code
INSTALLED = importlib.util.find_spec(PACKAGE) is not None


def tiny_weights():
    """The file's tensors, all layers four channels wide."""
    draw = torch.Generator().manual_seed(0)
    names = [name for slice_ in LAYERS for name in slice_]
    found = {"scaling_layer.shift": torch.zeros(1, 3, 1, 1)}  # not read
    for index, name in enumerate(names):
        shape = (WIDTH, 3 if index == 0 else WIDTH, 3, 3)
        found[f"net.{name}.weight"] = torch.randn(shape, generator=draw)
        found[f"net.{name}.bias"] = torch.rand(WIDTH, generator=draw)
    for index in range(len(LAYERS)):
        head = torch.rand(1, WIDTH, 1, 1, generator=draw)
        found[f"lin{index}.model.1.weight"] = head
    return found


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package of that name with these weights, whose code must not run."""

    def put(weights):
        folder = tmp_path / PACKAGE / "weights" / "vST0.0"
        folder.mkdir(parents=True)
        (tmp_path / PACKAGE / "__init__.py").write_text("raise ImportError('code ran')")
        file = folder / "vgg_shift_tolerant.pth"
        if isinstance(weights, bytes):
            file.write_bytes(weights)
        else:
            torch.save(weights, file)
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.delitem(sys.modules, PACKAGE, raising=False)
        return file

    return put


def images(size=(40, 48), seed=0):
    draw = torch.Generator().manual_seed(seed)
    return torch.rand(2, 2, 3, *size, generator=draw)


def distance(a, b):
    return edit3r.build("loss", "stlpips")(LossInputs(rendered=a, target=b))


def test_it_is_zero_for_equal_images_and_grows_with_noise(install):
    install(tiny_weights())
    clean = images()
    noise = torch.randn(clean.shape, generator=torch.Generator().manual_seed(1))
    weak, strong = (distance(clean + share * noise, clean) for share in (0.05, 0.3))
    assert float(distance(clean, clean)) == 0
    assert 0 < float(weak) < float(strong)
    assert torch.isclose(distance(clean, clean + 0.05 * noise), weak)


def test_the_first_slice_by_hand(install):
    """Convolutions that pass three channels on: features are the colours, scaled, of length 1."""
    weights = {name: torch.zeros_like(value) for name, value in tiny_weights().items()}
    for name in LAYERS[0]:
        for channel in range(3):
            weights[f"net.{name}.weight"][channel, channel, 1, 1] = 1
    weights["lin0.model.1.weight"][:] = 1
    install(weights)
    colours = torch.tensor([[0.9, 0.6, 0.7], [0.6, 0.9, 0.8]])
    a, b = colours[:, None, None, :, None, None].expand(2, 1, 1, 3, 32, 32)
    shift, scale = (
        torch.tensor([-0.03, -0.088, -0.188]),
        torch.tensor([0.458, 0.448, 0.45]),
    )
    seen = torch.nn.functional.normalize((2 * colours - 1 - shift) / scale, dim=1)
    expected = (seen[0] - seen[1]).square().sum()
    assert torch.isclose(distance(a, b), expected, rtol=1e-4)


def test_pooling_takes_the_largest_and_blurs_before_it_halves():
    x = torch.zeros(1, 1, 8, 8)
    x[0, 0, 4, 4] = 16.0
    # The largest of four is 16 at 3 and 4 of 7; two mirrored pixels behind the end show 4 again.
    # Blurred by 1/4 1/2 1/4 around -1, 1, 3, 5 and 7, along each side.
    row = torch.tensor([0.0, 0, 3, 1, 1])
    assert torch.allclose(_halved(x)[0, 0], row[:, None] * row, atol=1e-6)


def test_the_heads_weight_the_squared_differences_slice_by_slice(install):
    """With one head alone that is 1, a slice's own distance; all heads add up."""
    weights = tiny_weights()
    install(weights)
    a, b = images(seed=0), images(seed=2)
    whole = distance(a, b)
    network = edit3r.build("loss", "stlpips")._network
    parts = []
    for kept in range(len(LAYERS)):
        for index in range(len(LAYERS)):
            head = getattr(network, f"lin{index}_model_1_weight")
            original = weights[f"lin{index}.model.1.weight"]
            head.copy_(original if index == kept else torch.zeros_like(original))
        parts.append(network(a.flatten(0, 1), b.flatten(0, 1)).mean())
    assert all(float(part) > 0 for part in parts)
    assert torch.isclose(sum(parts), whole, rtol=1e-4)


@pytest.mark.parametrize("size", [(1, 1), (3, 70), (33, 32)])
def test_any_size_has_a_finite_distance_and_gradient(install, size):
    install(tiny_weights())
    target = images(size)
    for start in (target, 1 - target, torch.zeros_like(target)):
        rendered = start.clone().requires_grad_()
        value = distance(rendered, target)
        value.backward()
        assert value.isfinite() and rendered.grad.isfinite().all()


@pytest.mark.parametrize(
    "claim", sorted({*claims(CONTRACTS["loss"])} - {*claims(Contract)})
)
def test_it_keeps_the_contract(install, claim):
    install(tiny_weights())
    getattr(contract_for("loss", "stlpips")(), claim)()


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        (b"no weights", "cannot be read"),
        ({"net.slice1.0.weight": torch.zeros(4, 3, 3, 3)}, "lacks 30 of the tensors"),
    ],
)
def test_a_damaged_file_is_a_sentence(install, weights, words):
    file = install(weights)
    with pytest.raises(InputError, match=words) as error:
        edit3r.build("loss", "stlpips")
    assert str(file) in str(error.value)


@pytest.mark.skipif(not INSTALLED, reason="stlpips-pytorch is not installed")
def test_with_the_real_weights_it_says_what_the_package_s_own_code_says():
    """Two pictures made of sines, compared once with that code (0.0.2)."""
    y, x = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    waves = [0.5 + 0.4 * torch.sin(x / (3 + c) + y / (5 - c)) for c in range(3)]
    picture = torch.stack(waves)[None, None]
    shifted = picture.roll(1, -1)
    coarse = torch.nn.functional.avg_pool2d(picture[0], 4)
    coarse = torch.nn.functional.interpolate(coarse, size=(48, 64))[None]
    assert float(distance(picture, picture)) == 0
    found = [float(distance(one, picture)) for one in (shifted, coarse)]
    assert found == pytest.approx([SHIFTED, COARSE], rel=1e-3)
