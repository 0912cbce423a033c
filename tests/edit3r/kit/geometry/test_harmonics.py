import pytest
import torch

from edit3r.kit.geometry import harmonics


def _directions(count):
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(
        torch.randn(count, 3, dtype=torch.float64, generator=generator), dim=-1
    )


def test_the_basis_is_orthonormal_on_the_sphere():
    """Integrals over the sphere by Gauss-Legendre in z and the trapezoid rule in azimuth are exact
    to degree 8.
    """
    import numpy as np

    nodes, weights = np.polynomial.legendre.leggauss(10)
    azimuth = np.arange(20) * 2 * np.pi / 20
    z, phi = (torch.as_tensor(a) for a in np.meshgrid(nodes, azimuth, indexing="ij"))
    radius = (1 - z * z).sqrt()
    directions = torch.stack((radius * phi.cos(), radius * phi.sin(), z), -1)
    weight = torch.as_tensor(weights)[:, None].expand(10, 20) * 2 * np.pi / 20
    values = harmonics.basis(directions, 4)
    gram = torch.einsum("ijk,ijl,ij->kl", values, values, weight)
    assert torch.allclose(gram, torch.eye(25, dtype=torch.float64), atol=1e-12)


def test_signs_are_those_of_3dgs():
    """Degree 1 is (-y, z, -x) times 0.4886, as every viewer of splat files expects."""
    x, y, z = (
        harmonics.basis(torch.eye(3, dtype=torch.float64)[i], 1)[1:] for i in range(3)
    )
    factor = 0.4886025119029199
    assert x.tolist() == pytest.approx([0, 0, -factor])
    assert y.tolist() == pytest.approx([-factor, 0, 0])
    assert z.tolist() == pytest.approx([0, factor, 0])


@pytest.mark.parametrize("degree", range(5))
def test_lower_degrees_are_a_prefix_of_higher_ones(degree):
    directions = _directions(7)
    count = (degree + 1) ** 2
    assert torch.equal(
        harmonics.basis(directions, degree), harmonics.basis(directions, 4)[:, :count]
    )


def test_a_plain_colour_survives_the_round_trip():
    colours = torch.rand(5, 3, dtype=torch.float64)
    assert torch.allclose(
        harmonics.dc_to_colour(harmonics.colour_to_dc(colours)), colours, atol=1e-15
    )
