"""Rotations as wxyz quaternions and matrices, and the covariances they give."""

import torch
from jaxtyping import Float
from torch import Tensor


def normalise_quats(
    quats: Float[Tensor, "*batch 4"], eps: float = 1e-12
) -> Float[Tensor, "*batch 4"]:
    """Unit quaternions; one shorter than `eps` becomes the identity, with zero gradient."""
    norm = quats.norm(dim=-1, keepdim=True)
    identity = torch.zeros_like(quats)
    identity[..., 0] = 1
    safe = norm > eps
    return torch.where(
        safe, quats / torch.where(safe, norm, torch.ones_like(norm)), identity
    )


def quats_to_matrices(quats: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of wxyz quaternions of any norm."""
    w, x, y, z = normalise_quats(quats).unbind(-1)
    rows = (
        torch.stack(
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)), -1
        ),
        torch.stack(
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)), -1
        ),
        torch.stack(
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)), -1
        ),
    )
    return torch.stack(rows, -2)


def matrices_to_quats(
    matrices: Float[Tensor, "*batch 3 3"],
) -> Float[Tensor, "*batch 4"]:
    """Unit wxyz quaternions, w >= 0, of rotation matrices; by the largest component (Shepperd)."""
    m = matrices
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    squared = torch.stack(
        (1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz), -1
    )
    a = m[..., 2, 1] - m[..., 1, 2]
    b = m[..., 0, 2] - m[..., 2, 0]
    c = m[..., 1, 0] - m[..., 0, 1]
    d = m[..., 1, 0] + m[..., 0, 1]
    e = m[..., 0, 2] + m[..., 2, 0]
    f = m[..., 2, 1] + m[..., 1, 2]
    # Row k: four times (component k) times the quaternion.
    candidates = torch.stack(
        (
            torch.stack((squared[..., 0], a, b, c), -1),
            torch.stack((a, squared[..., 1], d, e), -1),
            torch.stack((b, d, squared[..., 2], f), -1),
            torch.stack((c, e, f, squared[..., 3]), -1),
        ),
        -2,
    )
    best = squared.argmax(-1)[..., None, None].expand(*squared.shape[:-1], 1, 4)
    quats = normalise_quats(candidates.gather(-2, best).squeeze(-2))
    return torch.where(quats[..., :1] < 0, -quats, quats)


def covariances(
    scales: Float[Tensor, "*batch 3"], quats: Float[Tensor, "*batch 4"]
) -> Float[Tensor, "*batch 3 3"]:
    """R diag(scales)^2 R^T."""
    factor = quats_to_matrices(quats) * scales[..., None, :]
    return factor @ factor.transpose(-1, -2)


def rotation_angle(
    a: Float[Tensor, "*batch 3 3"], b: Float[Tensor, "*batch 3 3"]
) -> Float[Tensor, "*batch"]:
    """Angle between two rotations [radians]; by the chord, so accurate for small angles too."""
    chord = (a - b).flatten(-2).norm(dim=-1) / (2 * 2**0.5)
    return 2 * torch.asin(chord.clamp(max=1))


def cross_matrix(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The matrix [v]x whose product with w is the cross product of v and w."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    rows = (
        torch.stack((zero, -z, y), -1),
        torch.stack((z, zero, -x), -1),
        torch.stack((-y, x, zero), -1),
    )
    return torch.stack(rows, -2)
