"""Where a fit begins: a reconstruction moved to the known poses, or random points."""

from dataclasses import replace

import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from edit3r.errors import InputError, MatchingError
from edit3r.geometry.alignment import median_scale
from edit3r.geometry.cameras import invert_rigid, pixel_rays, relative_to_first, scale_poses
from edit3r.geometry.harmonics import colour_to_dc
from edit3r.geometry.pose import estimate_cameras
from edit3r.geometry.rotations import matrices_to_quats, quats_to_matrices
from edit3r.interfaces import Reconstructor
from edit3r.reporting import note, warn
from edit3r.stage_checks import check_reconstruction, errors_named_after
from edit3r.types import Cameras, Gaussians, Reconstruction, Views
from edit3r_optimisers.settings import MethodSettings

RANDOM_OPACITY = 0.1  # 3D Gaussian Splatting, released code
RANDOM_DEPTHS = (0.3, 3.0)  # nearest and farthest random point, in distances to where the cameras look
NEIGHBOURS = 3  # whose mean distance is the size of a random point (3D Gaussian Splatting, section 7.1)
VISIBLE_OPACITY = 0.05  # a fainter first Gaussian has next to no gradient and would never show what it is worth
FAR_AWAY = 10.0  # distance to a scene that no two cameras look at together, in distances between cameras


def begin(photos: Views, reconstructor: Reconstructor, settings: MethodSettings) -> tuple[Gaussians, Cameras]:
    """Return first Gaussians for one scene's unedited photos (batch 1) and the photos' cameras, in view 0's frame.

    The poses are the known ones, else those of the reconstruction. Raises MatchingError when neither is there, and
    InputError for random points without known poses.
    """
    known = None
    if photos.c2w is not None:
        known = Cameras(relative_to_first(photos.c2w), photos.intrinsics, photos.image_size)
    if settings.start == "random":
        if known is None:
            raise InputError(
                "start=random needs known poses and the photos carry none; "
                "give Views with c2w, or begin from a reconstruction (start=reconstructor)."
            )
        return random_points(photos, known, settings.points, settings.seed), known
    try:
        first = _reconstructed(photos, reconstructor)
    except MatchingError as error:
        if known is None:
            raise
        warn(f"the first reconstruction failed ({error}); poses are known, so the fit begins from random points.")
        return random_points(photos, known, settings.points, settings.seed), known
    gaussians = first.gaussians if known is None else moved_to(first.gaussians, first.cameras, known)
    gaussians = replace(gaussians, opacities=gaussians.opacities.clamp(min=VISIBLE_OPACITY))
    note("refit.first_gaussians", min(gaussians.count, settings.points))
    return thinned(gaussians, settings.points, settings.seed), known or first.cameras


def _reconstructed(photos: Views, reconstructor: Reconstructor) -> Reconstruction:
    """Reconstruct the unedited photos; the result has cameras and no transparent Gaussians."""
    with errors_named_after(reconstructor):
        answer = reconstructor(photos, source=photos)
    check_reconstruction(reconstructor, photos, answer)
    cameras = answer.cameras or estimate_cameras(answer.gaussians, photos)
    return Reconstruction(answer.gaussians.select(answer.gaussians.opacities[0] > 0), cameras)


def moved_to(gaussians: Gaussians, predicted: Cameras, known: Cameras) -> Gaussians:
    """Move Gaussians from predicted to known poses of the views, each with the view it came from.

    They stay on the pixels they came from; the unit of length is scaled by the median ratio of the views' distances
    from view 0. Harmonics keep only what looks the same from everywhere.
    """
    scale = median_scale(predicted.c2w[0, 1:, :3, 3], known.c2w[0, 1:, :3, 3])
    motion = (known.c2w[0] @ invert_rigid(scale_poses(predicted.c2w[0], scale)))[gaussians.view_index.clamp(min=0)]
    rotations = motion[:, :3, :3]
    means = (rotations @ (gaussians.means[0] * scale)[..., None])[..., 0] + motion[:, :3, 3]
    quats = matrices_to_quats(rotations @ quats_to_matrices(gaussians.quats[0]))
    return replace(
        gaussians,
        means=means[None],
        scales=gaussians.scales * scale,
        quats=quats[None],
        harmonics=gaussians.harmonics[:, :, :1],
    )


def thinned(gaussians: Gaussians, most: int, seed: int) -> Gaussians:
    """Choose at most `most` Gaussians at random and widen them so that they still cover their surfaces."""
    if gaussians.count <= most:
        return gaussians
    order = torch.randperm(gaussians.count, generator=torch.Generator().manual_seed(seed))
    chosen = gaussians.select(order[:most].sort().values.to(gaussians.means.device))
    return replace(chosen, scales=chosen.scales * (gaussians.count / most) ** 0.5)


def random_points(photos: Views, cameras: Cameras, count: int, seed: int) -> Gaussians:
    """Put Gaussians at random depths behind random pixels, with their colours, as large as neighbours are far apart."""
    generator = torch.Generator().manual_seed(seed)
    height, width = cameras.image_size
    view = torch.randint(cameras.count, (count,), generator=generator)
    row = torch.randint(height, (count,), generator=generator)
    column = torch.randint(width, (count,), generator=generator)
    near, far = (share * _viewing_distance(cameras) for share in RANDOM_DEPTHS)
    depth = 1 / torch.lerp(torch.tensor(1 / far), torch.tensor(1 / near), torch.rand(count, generator=generator))
    rays = pixel_rays(cameras.intrinsics[0], cameras.image_size).cpu()[view, row, column]
    poses = cameras.c2w[0].cpu()[view]
    means = (poses[:, :3, :3] @ (rays * depth[:, None])[..., None])[..., 0] + poses[:, :3, 3]
    colours = photos.images[0].cpu()[view, :, row, column]
    quats = torch.zeros(1, count, 4)
    quats[..., 0] = 1
    points = Gaussians(
        means[None],
        _spacing(means)[None, :, None].repeat(1, 1, 3),
        quats,
        torch.full((1, count), RANDOM_OPACITY),
        colour_to_dc(colours)[None, :, None],
        view,
    )
    return points.to(photos.images)


def _spacing(points: Float[Tensor, "point 3"]) -> Float[Tensor, "point"]:
    """Return the mean distance of each point to its nearest others [scene units]."""
    if len(points) < 2:
        return torch.full((len(points),), 0.1)
    near = min(NEIGHBOURS, len(points) - 1)
    distances, _ = cKDTree(points.double().numpy()).query(points.double().numpy(), k=near + 1)
    return torch.from_numpy(distances[:, 1:].mean(-1)).float().clamp(min=1e-6)


def _viewing_distance(cameras: Cameras) -> float:
    """Return the mean distance along the optical axes to the point nearest to all of them [scene units]."""
    centres, axes = cameras.c2w[0, :, :3, 3].double().cpu(), cameras.c2w[0, :, :3, 2].double().cpu()
    across = torch.eye(3).double() - axes[:, :, None] * axes[:, None, :]
    middle = torch.linalg.lstsq(across.sum(0), (across @ centres[..., None]).sum(0)).solution[:, 0]
    distance = float(((middle - centres) * axes).sum(-1).mean())
    baseline = float((centres - centres.mean(0)).norm(dim=-1).max())
    farthest = FAR_AWAY * (baseline or 1.0)
    return distance if 0 < distance < farthest else farthest
