"""Bundle adjustment: poses of several views and the points they share, settled together (pycolmap,
Ceres).

Placing one view after the other adds up errors. Here the matches of all pairs are joined into
tracks (one point seen by several views), and poses and points move until the points fall onto their
pixels in every view. Where nobody knows the lens, the one focal length of all views moves with
them.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from edit3r.kit.geometry.quiet_pycolmap import pycolmap
from edit3r_geometry.cameras import (
    CalibratedImage,
    Pose,
    parallax_degrees,
    project,
    rays_through,
    triangulate,
)
from edit3r_geometry.pairs import MIN_PARALLAX

ROUNDS = 2
"""Adjustments, each on the points that agree with the poses so far."""
LOOSE = 4.0
"""How many times the threshold a point may be off its pixel in the first round. No figure kept."""
LEAST_POINTS = 20
"""Points below which nothing is adjusted."""
MOST_ZOOM = 1.25
"""Change of a focal length beyond which the matches do not tell it: then it stays as it was.
No figure kept.
"""

MOST_TRACKS, FIRST_TRACKS = 2000, 600
"""More are not adjusted: those of most views are enough to settle poses and lens, and
fewer for a first adjustment, after which matches are chosen anew.
"""
LEAST_GAIN = 1e-5
"""Share of the error below which a step is the last: poses stay within a thousandth of a degree of
where ten times as many steps bring them.
"""

Tracks = list[dict[int, int]]  # view: keypoint, of each track


def adjust(
    images: Sequence[CalibratedImage],
    keypoints: Sequence[Float[np.ndarray, "keypoint 2"]],
    matches: dict[tuple[int, int], Int[np.ndarray, "match 2"]],
    poses: dict[int, Pose],
    threshold: float,
    free_focal: bool = False,
    most_tracks: int = MOST_TRACKS,
) -> tuple[dict[int, Pose], float]:
    """Return better `poses` (world to camera, the first the frame), and by what factor all focal
    lengths change.

    `matches` are pairs of keypoint indices of two views that agree on an epipolar geometry.
    `threshold` is how far a point may be off its pixel [pixels]. The unit of length stays that of
    the poses given. The factor is 1 unless `free_focal`, which asks for images of one size and one
    lens.
    """
    placed, start, zoom = sorted(poses), poses, 1.0
    tracks = join_tracks(
        {pair: found for pair, found in matches.items() if set(pair) <= set(placed)},
        keypoints,
    )[:most_tracks]
    for limit in np.geomspace(LOOSE * threshold, threshold, ROUNDS):
        zoomed = [image.zoomed(zoom) for image in images]
        scene = _scene(zoomed, keypoints, tracks, poses, float(limit), free_focal)
        if scene.num_points3D() < LEAST_POINTS:
            return start, 1.0
        # Not pycolmap.bundle_adjustment, which writes to the terminal.
        pycolmap.create_default_bundle_adjuster(
            _options(threshold, free_focal), _problem(scene), scene
        ).solve()
        poses = _poses_of(scene, placed, poses)
        zoom *= float(
            scene.cameras[placed[0] + 1].params[0] / zoomed[placed[0]].K[0, 0]
        )
    if not 1 / MOST_ZOOM < zoom < MOST_ZOOM:
        return adjust(images, keypoints, matches, start, threshold)
    return poses, zoom


def fit_distortion(
    images: Sequence[CalibratedImage],
    keypoints: Sequence[Float[np.ndarray, "keypoint 2"]],
    matches: dict[tuple[int, int], Int[np.ndarray, "match 2"]],
    poses: dict[int, Pose],
    threshold: float,
) -> tuple[float, float]:
    """The radial distortion k1 (OpenCV's) of the one lens of all images, and how much it explains.

    That is the share of the mean distance between points and pixels that goes when k1 is free
    beside the focal length, both fitted to the same points.
    """
    tracks = join_tracks(
        {pair: found for pair, found in matches.items() if set(pair) <= set(poses)},
        keypoints,
    )
    errors, radial = [], 0.0
    for free in (False, True):
        scene = _scene(
            images, keypoints, tracks, poses, LOOSE * threshold, True, "SIMPLE_RADIAL"
        )
        if scene.num_points3D() < LEAST_POINTS:
            return 0.0, 0.0
        options = _options(threshold, True)
        options.refine_extra_params = free
        pycolmap.create_default_bundle_adjuster(options, _problem(scene), scene).solve()
        scene.update_point_3d_errors()
        errors.append(
            float(np.median([point.error for point in scene.points3D.values()]))
        )
        radial = float(next(iter(scene.cameras.values())).params[3])
    return radial, 1 - errors[1] / errors[0]


def join_tracks(
    matches: dict[tuple[int, int], Int[np.ndarray, "match 2"]],
    keypoints: Sequence[Float[np.ndarray, "keypoint 2"]],
) -> Tracks:
    """Join matches that share a keypoint; the tracks of most views, if there are very many.

    A track that sees one view twice is left out: one of its matches is wrong.
    """
    starts = np.cumsum([0, *(len(points) for points in keypoints)])
    links = [
        indices + starts[list(pair)]
        for pair, indices in matches.items()
        if len(indices)
    ]
    if not links:
        return []
    first, second = np.concatenate(links).T
    total = int(starts[-1])
    _, label = connected_components(
        coo_matrix((np.ones(len(first)), (first, second)), (total, total)),
        directed=False,
    )
    linked = np.unique(np.concatenate((first, second)))
    linked = linked[np.argsort(label[linked], kind="stable")]
    groups = np.split(linked, np.flatnonzero(np.diff(label[linked])) + 1)
    tracks = []
    for group in groups:
        views = np.searchsorted(starts, group, side="right") - 1
        if len(set(views)) == len(views):
            tracks.append(dict(zip(views.tolist(), (group - starts[views]).tolist())))
    return sorted(tracks, key=len, reverse=True)[:MOST_TRACKS]


def _scene(
    images: Sequence[CalibratedImage],
    keypoints: Sequence[Float[np.ndarray, "keypoint 2"]],
    tracks: Tracks,
    poses: dict[int, Pose],
    limit: float,
    one_lens: bool,
    model: str = "SIMPLE_PINHOLE",
) -> pycolmap.Reconstruction:
    """The views, and of the tracks those points and sightings that fall within `limit` pixels."""
    scene = pycolmap.Reconstruction()
    for view, pose in poses.items():
        height, width = images[view].size
        k = images[view].K
        number = 1 + (min(poses) if one_lens else view)
        named, lens = (
            (model, [k[0, 0]]) if one_lens else ("PINHOLE", [k[0, 0], k[1, 1]])
        )
        if number not in scene.cameras:
            lens += [k[0, 2], k[1, 2], *([0.0] if named == "SIMPLE_RADIAL" else [])]
            camera = pycolmap.Camera(
                model=named, width=width, height=height, params=lens, camera_id=number
            )
            scene.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(
            f"{view}", keypoints[view], camera_id=number, image_id=view + 1
        )
        scene.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose.matrix[:3]))
    sightings = _sightings(tracks, len(keypoints))
    points = _points(sightings, images, keypoints, poses)
    near = np.zeros(sightings.shape, bool)
    for view, pose in poses.items():
        own = np.flatnonzero((sightings[:, view] >= 0) & np.isfinite(points[:, 0]))
        seen = pose.apply(points[own])
        off = np.linalg.norm(
            project(seen, images[view].K) - keypoints[view][sightings[own, view]],
            axis=1,
        )
        near[own, view] = (seen[:, 2] > 0) & (off < limit)
    for index in np.flatnonzero(near.sum(1) >= 2):
        elements = [
            pycolmap.TrackElement(view + 1, sightings[index, view])
            for view in np.flatnonzero(near[index])
        ]
        scene.add_point3D(points[index], pycolmap.Track(elements))
    return scene


def _sightings(tracks: Tracks, views: int) -> Int[np.ndarray, "track view"]:
    """The keypoint of each track in each view, -1 where the view does not see it."""
    found = np.full((len(tracks), views), -1)
    for index, track in enumerate(tracks):
        found[index, list(track)] = list(track.values())
    return found


def _points(
    sightings: Int[np.ndarray, "track view"],
    images: Sequence[CalibratedImage],
    keypoints: Sequence[Float[np.ndarray, "keypoint 2"]],
    poses: dict[int, Pose],
) -> Float[np.ndarray, "track 3"]:
    """Each track's point, of the two views that see it from most different sides; NaN: none."""
    rays = {view: rays_through(keypoints[view], images[view].K) for view in poses}
    widest = np.full(len(sightings), MIN_PARALLAX)
    points = np.full((len(sightings), 3), np.nan)
    for a, b in combinations(sorted(poses), 2):
        both = np.flatnonzero((sightings[:, [a, b]] >= 0).all(1))
        rays_a, rays_b = (rays[view][sightings[both, view]] for view in (a, b))
        pose = poses[b].after(poses[a].inverse())
        angle = parallax_degrees(rays_a, rays_b, pose)
        depth_a, depth_b = triangulate(rays_a, rays_b, pose)
        placed = np.where(np.minimum(depth_a, depth_b) > 0, depth_a, np.nan)
        wider = angle > widest[both]
        widest[both[wider]] = angle[wider]
        points[both[wider]] = poses[a].inverse().apply(rays_a * placed[:, None])[wider]
    return points


def _problem(scene: pycolmap.Reconstruction) -> pycolmap.BundleAdjustmentConfig:
    """All views and points; two cameras hold frame and unit of length."""
    problem = pycolmap.BundleAdjustmentConfig()
    for image in scene.images:
        problem.add_image(image)
    problem.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    return problem


def _options(threshold: float, free_focal: bool) -> pycolmap.BundleAdjustmentOptions:
    """Poses and points, and the focal length where it is free.

    A robust loss, and one thread, so that the same matches give the same poses.
    """
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=free_focal,
        refine_extra_params=False,
        refine_principal_point=False,
        print_summary=False,
    )
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.loss_function_scale = 0.5 * threshold
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.function_tolerance = LEAST_GAIN
    return options


def _poses_of(
    scene: pycolmap.Reconstruction, placed: Sequence[int], before: dict[int, Pose]
) -> dict[int, Pose]:
    """The adjusted poses in the first view's frame, as far from it in the median as before."""
    found = {}
    for view in placed:
        matrix = scene.image(view + 1).cam_from_world().matrix()
        found[view] = Pose(matrix[:, :3], matrix[:, 3])
    origin = found[placed[0]].inverse()
    found = {view: pose.after(origin) for view, pose in found.items()}
    lengths, wanted = (
        [np.linalg.norm(poses[view].translation) for view in placed[1:]]
        for poses in (before, found)
    )
    scale = float(np.median(np.divide(lengths, wanted)))
    return {
        view: Pose(pose.rotation, pose.translation * scale)
        for view, pose in found.items()
    }
