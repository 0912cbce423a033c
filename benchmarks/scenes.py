"""What runs show at their photos and between them: presets, the default run, floaters, simplifying.

python benchmarks/scenes.py dial|default-run|held-out|floaters|simplify --help

Likeness is PSNR [dB], SSIM, LPIPS and share of detail (benchmarks/likeness.py).
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from edit3r_geometry.depth_maps import DepthSettings
from edit3r_measure.novel_view import PredictedScene, views_of
from edit3r_measure.protocol import align
from edit3r_measure.scene_sources import (
    EvaluationScene,
    SceneOptions,
    SceneSource,
    find_scenes,
)
from edit3r_refiners.api import find_floaters
from harness import HELD_OUT, Row, for_tuning, run_benchmark
from jaxtyping import Float
from likeness import (
    TITLE,
    Likeness,
    as_numpy,
    between,
    drawn,
    likeness,
    mean,
    unseen_camera,
)
from torch import Tensor

import edit3r
from edit3r import default_registry
from edit3r.contract.errors import Edit3rError, InputError, MatchingError
from edit3r.contract.interfaces import Geometry, RefineInputs
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit import asking
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.paths import interpolate_poses
from edit3r.kit.photos.images import find_photos
from edit3r.kit.photos.posed_folder import read_posed_folder
from edit3r.kit.reconstructing import WithMatcher
from edit3r.kit.rendering import path_around
from edit3r.kit.scenes.ply import save_ply
from edit3r.kit.workers import run_resumable
from edit3r.running.geometry import default_matcher
from edit3r.running.quality import preset_point

FULL = 512  # long side of the photos that are compared [pixels]

# ---- dial ----

PAIRS = (
    *(
        "fern 10,14",
        "fox 25,29",
        "monstree 0,2",
        "dinosaur 31,34",
        "7scenes_rgbd 12,14",
    ),
    *("bear 0,2", "fern 0,4", "fox 0,8", "dinosaur 0,1", "fox 36,38"),
)
STEPS, RATE = 40, 0.0005  # that bring a camera to where the scene shows its photo best

# CPU seconds; photos given, photo between at its true pose, and where it is shown best
Measured = tuple[float, Likeness, Likeness, Likeness]


def dial(
    data: Path,
    *,
    presets: Sequence[str] = ("fast", "balanced", "default", "best"),
    only: Sequence[str] = PAIRS,
    poses: str = "unknown",
) -> Iterator[Row]:
    """Does a dearer preset show more? Ten wide pairs of real photos, at the photos and between
    them.

        python benchmarks/scenes.py dial photos/ --presets fast default best
        python benchmarks/scenes.py dial photos/ --only "fox 25,29" --poses known

    A row a pair and preset (`default`: none), then the means: CPU seconds of the run, and PSNR
    [dB], SSIM, LPIPS and share of detail (benchmarks/likeness.py) at 512 pixels, whatever the
    preset's size: of the photos given; of the photo between the two at its true pose; and where the
    scene shows it best: poses of a pair are off by a fraction of a degree, and a sharp picture
    beside its place loses more than a soft one. `--poses known` gives the run the true poses of its
    photos too.
    """
    measured: dict[str, list[Measured]] = {preset: [] for preset in presets}
    for pair in only:
        scene, _, numbers = pair.partition(" ")
        chosen = [int(number) for number in numbers.split(",")]
        for preset, own in measured.items():
            own.append(measure_preset(data / scene, chosen, preset, poses == "known"))
            yield cells(pair, preset, own[-1:])
    for preset, own in measured.items():
        yield cells("mean", preset, own)


def cells(pair: str, preset: str, several: Sequence[Measured]) -> Row:
    seconds, *figures = zip(*several)
    titles = (
        f"photos: {TITLE}",
        "between, true pose",
        "between, where shown best",
    )
    return {
        "pair": pair,
        "preset": preset,
        "CPU s": (float(np.mean(seconds)), ".2f"),
        **{title: str(mean(own)) for title, own in zip(titles, figures)},
    }


def measure_preset(
    folder: Path, chosen: list[int], preset: str, known: bool
) -> Measured:
    """Means over the photos given, and over those between them."""
    cameras = read_posed_folder(folder).cameras
    centres = np.stack([camera.c2w[:3, 3] for camera in cameras])
    targets = [target for target in between(centres, chosen) if target is not None]
    files = [folder / cameras[index].file for index in (*chosen, *targets)]
    whole, count = edit3r.load_views(files, size=FULL), len(chosen)
    quality = None if preset == "default" else preset
    size = preset_point(quality)["settings"]["size"] if quality else FULL
    given = edit3r.load_views(files[:count], size=size)
    posed = whole.c2w[:, :count] if known else None
    options = {"matcher": posed_matcher(quality)}
    start = time.process_time()
    result = edit3r.run(
        replace(given, c2w=posed),
        editor="none",
        outputs=[],
        quality=quality,
        **options if known else {},
    )
    seconds = time.process_time() - start
    figures = [compared(result, whole, view) for view in range(count, whole.count)]
    shown = [mean(own) for own in zip(*figures)]
    return seconds, at_the_photos(result, whole), *shown


def at_the_photos(result: edit3r.RunResult, whole: edit3r.Views) -> Likeness:
    """How the placed photos of a run, the first of `whole`, are shown at their full size."""
    placed = [view for view, there in enumerate(result.verdict.placed) if there]
    cameras = result.cameras.select(range(len(placed))).at(whole.image_size)
    return mean(
        [
            likeness(drawn(result, cameras.select([camera])), as_numpy(whole, view))
            for camera, view in enumerate(placed)
        ]
    )


def compared(
    result: edit3r.RunResult, whole: edit3r.Views, target: int
) -> tuple[Likeness, Likeness]:
    """How view `target` is shown from its true pose, and from where it is shown best."""
    placed = [view for view, there in enumerate(result.verdict.placed) if there]
    camera = unseen_camera(result, whole, placed, target)
    photo, scene = whole.images[:, [target]], in_unit(result)
    best = align(scene, camera, photo, F.mse_loss, STEPS, RATE)
    true = as_numpy(whole, target)
    first, last = (likeness(drawn(result, place), true) for place in (camera, best))
    return first, last


def in_unit(result: edit3r.RunResult) -> SimpleNamespace:
    """The scene as `align` takes it, its unit of length the distance of the first two cameras."""
    cameras = result.cameras.c2w[0]
    pose = (torch.linalg.inv(cameras[0]) @ cameras[1]).numpy()
    made = SimpleNamespace(gaussians=result.gaussians)
    return SimpleNamespace(
        predicted_pose=pose, rasterizer=result.rasterizer, reconstruction=made
    )


def posed_matcher(quality: str | None) -> dict:
    """The matcher that trusts poses, as fine as that of the preset."""
    chosen = preset_point(quality)["settings"] if quality else {}
    depth = default_matcher(default_registry()).settings.model_dump(
        include=set(DepthSettings.model_fields)
    )
    return {**depth, **chosen.get("matcher", {}), "name": "posed"}


# ---- default-run ----

FRAMES, DRAWN = 36, 6


def default_run(
    scenes: Sequence[str],
    *,
    settings: Sequence[str] = ("512:plain", "512", "384", "320"),
) -> Iterator[Row]:
    """What the default run costs and shows at several sizes, beside the run without refiners.

        python benchmarks/scenes.py default-run FOLDER:FIRST,SECOND ... --settings 512 384 512:plain

    Each scene is a folder with photos and a cameras.json and the numbers of two photos; poses are
    not used. `plain` stands for `--gaussians all --refine 0`. A row a run: processor seconds from
    images to Gaussians, of 36 frames of the camera path (from six of them), Gaussians; PSNR, SSIM,
    LPIPS and share of detail of the photos and of the one half-way at 512 pixels, whatever the size
    of the run.
    """
    for scene in scenes:
        folder, _, numbers = scene.rpartition(":")
        first, second = map(int, numbers.split(","))
        cameras = read_posed_folder(Path(folder)).cameras
        files = [
            Path(folder) / cameras[i].file
            for i in (first, second, (first + second) // 2)
        ]
        for setting in settings:
            size, _, plain = setting.partition(":")
            figures = measure_run(files[:2], files[2], int(size), plain == "plain")
            name = f"{Path(folder).name} {first}, {second}"
            yield {"scene and photos": name, "pixels": setting, **figures}


def measure_run(files: list[Path], middle: Path, size: int, plain: bool) -> Row:
    views = replace(edit3r.load_views(files, size=size), c2w=None)
    start = time.process_time()
    result = edit3r.run(
        views, editor="none", **({"gaussians": "all", "refine": 0} if plain else {})
    )
    made = time.process_time() - start
    path = path_around(result.cameras, result.rendered, FRAMES)
    start = time.process_time()
    with torch.no_grad():
        for frame in range(0, FRAMES, FRAMES // DRAWN):
            asking.render(result.rasterizer, result.gaussians, path.select([frame]))
    shown = (time.process_time() - start) * FRAMES / DRAWN
    full = edit3r.load_views([*files, middle], size=FULL)
    camera = unseen_camera(result, full, [0, 1], 2)
    half_way = likeness(drawn(result, camera), as_numpy(full, 2))
    return {
        "made in, CPU s": (made, ".2f"),
        "36 frames, CPU s": (shown, ".2f"),
        "Gaussians": (result.gaussians.count, ",d"),
        f"photos: {TITLE}": str(at_the_photos(result, full)),
        "half-way": str(half_way),
        "verdict": result.verdict.label,
    }


# ---- held-out ----


def held_out(data: Path) -> Iterator[Row]:
    """Scenes that no setting may be chosen by, and what the default run makes of them.

        python benchmarks/scenes.py held-out photos/

    The folder holds the photo sets of the benchmarks. Every two photos of a held-out scene are
    reconstructed by the default run without their poses. A row each: the verdict, the agreement
    (PSNR of each photo against the other's Gaussians, before refining), and PSNR, SSIM, LPIPS and
    share of detail of the photos, and, for scenes with known cameras, of the one that stands
    between the two. The other benchmarks refuse these scenes.
    """
    for scene in HELD_OUT:
        count = len(find_photos(data / scene / "images"))
        for pair in combinations(range(count), 2):
            name = f"{scene} {pair[0]}, {pair[1]}"
            yield {"held-out photos": name, **measure_held_out(data / scene, pair)}


def measure_held_out(folder: Path, pair: tuple[int, int]) -> Row:
    """The cells of one row after its first."""
    photos = find_photos(folder / "images")
    middle = range(pair[0] + 1, pair[1]) if is_posed(folder) else ()
    given = [photos[index] for index in (*pair, *middle)]
    whole = edit3r.load_views(given, size=FULL)
    try:
        result = edit3r.run(
            replace(whole.select(range(2)), c2w=None), editor="none", outputs=[]
        )
    except Edit3rError:
        return {"verdict": "refused"}
    agreement = ", ".join(f"{value:.1f}" for value in result.verdict.agreement or ())
    shown = [
        likeness(
            drawn(result, unseen_camera(result, whole, [0, 1], view)),
            as_numpy(whole, view),
        )
        for view in range(2, whole.count)
    ]
    return {
        "verdict": result.verdict.label,
        "agreement, dB": agreement,
        f"photos: {TITLE}": str(at_the_photos(result, whole)),
        "between": "; ".join(map(str, shown)) or "–",
    }


def is_posed(folder: Path) -> bool:
    """Whether the photos' cameras are known; of `leuven_pair` only the lens is."""
    try:
        return bool(read_posed_folder(folder).cameras)
    except InputError:
        return False


# ---- floaters ----

SETS = (
    *("bear 0,2", "bear 20,22", "bear 8,10,12", "fern 0,10", "fern 0,4,8", "fox 0,3"),
    *("fox 10,14,18", "monstree 0,1", "monstree 4,5,6", "7scenes_rgbd 0,3"),
    *("soh_pair 0,1", "stereo_motorcycle 0,1"),
)
BEFORE = 0.05  # share of the measured depth


def floaters(data: Path, *, only: Sequence[str] = SETS) -> Iterator[Row]:
    """How much stands in front of what the photos measured, and what `clean` would take.

        python benchmarks/scenes.py floaters photos/ --only "fern 0,10" "monstree 4,5,6"

    A row a set of photos, reconstructed by the default run with unknown lens and poses. Seen from a
    quarter, half and three quarters of the way between neighbouring photos: the share of the pixels
    with a measured depth whose surface stands more than a twentieth before the nearest one that any
    photo measured there (3 x 3 pixels). Then what `clean` takes of the Gaussians, and the share of
    the photos' pixels that change by it.
    """
    for name in only:
        folder, _, numbers = name.partition(" ")
        for_tuning([folder])
        files = find_photos(data / folder / "images")
        given = [files[int(number)] for number in numbers.split(",")]
        views = replace(edit3r.load_views(given, size=FULL, cameras="none"), c2w=None)
        result = edit3r.run(views, editor="none", outputs=[])
        matcher = default_matcher(default_registry())
        geometry = matcher.match(views).at(views.image_size)
        lens = geometry.calibrated(views).intrinsics
        found = find_floaters(result.gaussians, result.cameras, result.rasterizer)
        yield {
            "photos": name,
            "in front, %": (100 * in_front(result, geometry, lens), ".2f"),
            "clean takes, %": (100 * float(found.found.float().mean()), ".2f"),
            "pixels it changes, %": (100 * found.changed, ".2f"),
        }


@torch.no_grad()
def in_front(result: edit3r.RunResult, geometry: Geometry, lens: Tensor) -> float:
    """Mean share of the pixels whose surface stands before all that was measured there."""
    points = unproject(geometry.depths, lens, geometry.c2w)[0]
    sure = (geometry.confidence[0] >= 0.5) & geometry.registered[0][:, None, None]
    shares = []
    for camera in steps_between(result.cameras):
        nearest = nearest_depths(points[sure], camera)
        shown = result.rasterizer.render(result.gaussians, camera)
        depths = shown.depths.view_as(nearest)
        front = (shown.alphas.view_as(nearest) > 0.5) & nearest.isfinite()
        front &= depths < (1 - BEFORE) * nearest
        shares.append(float(front.sum() / nearest.isfinite().sum()))
    return sum(shares) / len(shares)


def steps_between(cameras: Cameras) -> Iterator[Cameras]:
    """A quarter, half and three quarters of the way from each camera to the next."""
    for first in range(cameras.count - 1):
        start, end = cameras.c2w[0, first : first + 2].double()
        for share in (0.25, 0.5, 0.75):
            pose = interpolate_poses(start, end, torch.tensor(share).double())
            yield replace(cameras.select([first]), c2w=pose.float()[None, None])


def nearest_depths(
    points: Float[Tensor, "point 3"], camera: Cameras
) -> Float[Tensor, "height width"]:
    """Camera z of the nearest point around each pixel; infinite where there is none."""
    height, width = camera.image_size
    places, depth = project(points, camera.intrinsics[0, 0], camera.c2w[0, 0])
    column, row = (places * places.new_tensor([width, height])).floor().long().T
    nearest = torch.full((height * width,), torch.inf)
    for right in (-1, 0, 1):
        for down in (-1, 0, 1):
            x, y = column + right, row + down
            inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
            index = (y * width + x)[inside]
            nearest.scatter_reduce_(0, index, depth[inside], "amin")
    return nearest.view(height, width)


# ---- simplify ----

SHARES = (0.1, 0.2, 0.33)
# as `simplify` does after merging
POLISH = {
    "steps": 10,
    "colour": 0.015,
    "opacity": 0.08,
    "scale": 0.08,
}
RENDER_REPEATS = 5
SHORT = ("all", "auto", *(f"simplify to {share:g}" for share in reversed(SHARES)))
# no training has seen these
UNSEEN = {"procedural": {"seed": 2024, "targets": 1, "angles": [5, 20]}}


def simplify(
    sources: Sequence[str],
    *,
    out: Path,
    recon: str = "classical",
    scenes: int = 3,
    generated: int = 3,
    short: bool = False,
    size: int = 256,
    shares: Sequence[float] = SHARES,
    refine: int = 30,
) -> Iterator[Row]:
    """What simplifying costs and what it leaves, beside dropping as many Gaussians at random or by
    opacity.

        python benchmarks/scenes.py simplify FOLDER... procedural --generated 12 --out results

    Each FOLDER holds photos of one scene with their cameras; a data set's name stands for generated
    scenes. Two photos are reconstructed; the scene with all its Gaussians, with those that the
    refiner `simplify` leaves, and with as many left by each rival (polished by as many photometric
    steps) is rendered and compared with the photo between the two. Rows by kind of scene: CPU
    seconds, sizes, likeness; stopped, it goes on where it was.
    """
    out.mkdir(parents=True, exist_ok=True)
    datasets = {
        name: {**settings, "image_size": size} for name, settings in UNSEEN.items()
    }
    found = []
    for source in for_tuning(sources):
        count = scenes if Path(source).is_dir() else generated
        options = SceneOptions(count, size, datasets)
        found += find_scenes(source, options, default_registry())
    jobs = {
        f"{scene.name} {recon} {shares} {refine}": scene
        for scene in found
        if scene.kind != "stereo"
    }
    measurement = Measurement(recon, shares, refine)
    done = run_resumable(jobs, measurement, out / "points.jsonl")
    for kind in dict.fromkeys(row["kind"] for row in done.values()):
        rows = [row for row in done.values() if row["kind"] == kind]
        points = [row["points"] for row in rows if "points" in row]
        matched = f"{kind}, {len(points)} of {len(rows)} matched"
        for name in points[0] if points else ():
            if name in SHORT or not short:
                yield {"kind": matched, "variant": name, **against_all(points, name)}


@dataclass(frozen=True)
class Measurement:
    """Measures one scene in every variant."""

    recon: str
    shares: Sequence[float]
    refine: int

    def __call__(self, source: SceneSource) -> dict[str, Any]:
        scene = source.load()
        views = views_of([scene.inputs[0], scene.inputs[-1]])
        try:
            reconstruction = WithMatcher(
                edit3r.build("reconstructor", self.recon),
                edit3r.build("matcher", "auto"),
            )(views)
        except MatchingError as error:
            return {"kind": source.kind, "failure": str(error)}
        variants = self._variants(reconstruction, views)
        return {
            "kind": source.kind,
            "points": {n: score(g, s, reconstruction, scene) for n, g, s in variants},
        }

    def _variants(
        self, reconstruction: Reconstruction, views: Views
    ) -> Iterator[tuple[str, Gaussians, float]]:
        """Give name, Gaussians and CPU seconds of each way to have fewer."""
        everything, cameras, rasterizer = (
            reconstruction.gaussians,
            reconstruction.cameras,
            build_rasterizer(),
        )

        def refined(
            scene: Gaussians, views: Views, refiner: str, **settings: Any
        ) -> tuple[Gaussians, float]:
            step = edit3r.build("refiner", refiner, **settings)
            start = time.process_time()
            return step(
                scene, RefineInputs(cameras, views, rasterizer)
            ), time.process_time() - start

        # the first run of a process compiles kernels
        refined(everything, views, "simplify", gaussians="auto")
        auto, seconds = refined(everything, views, "simplify", gaussians="auto")
        yield "all", everything, 0.0
        yield "auto", auto, seconds
        yield "all, refined", *refined(everything, views, "refine", steps=self.refine)
        yield "auto, refined", *refined(auto, views, "refine", steps=self.refine)
        with torch.no_grad():
            shown = replace(
                views, images=rasterizer.render(everything, cameras).images.clamp(0, 1)
            )
        orders = {
            "random": torch.randperm(
                everything.count, generator=torch.Generator().manual_seed(0)
            ),
            "opacity": everything.opacities[0].argsort(descending=True, stable=True),
        }
        for share in self.shares:
            count = round(share * everything.count)
            yield (
                f"simplify to {share:g}",
                *refined(everything, views, "simplify", gaussians=count),
            )
            for name, order in orders.items():
                yield (
                    f"{name}, {share:g}",
                    *refined(
                        everything.select(order[:count]), shown, "refine", **POLISH
                    ),
                )


def build_rasterizer():
    """Return the rasterizer of all figures, on one thread."""
    return edit3r.build("rasterizer", "numba", threads=1)


def score(
    gaussians: Gaussians,
    seconds: float,
    reconstruction: Reconstruction,
    scene: EvaluationScene,
) -> dict[str, float]:
    """Return the figures of one variant: share left, novel view, CPU seconds and size of the
    file.
    """
    times = []
    for _ in range(RENDER_REPEATS):
        start = time.process_time()
        fewer = replace(reconstruction, gaussians=gaussians)
        predicted = PredictedScene(fewer, build_rasterizer(), scene.inputs)
        image = predicted.show(predicted.camera_of(scene.target)).image
        times.append(time.process_time() - start)
    with tempfile.TemporaryDirectory() as folder:
        save_ply(Path(folder) / "scene.ply", gaussians)
        size = (Path(folder) / "scene.ply").stat().st_size
    return {
        "share": gaussians.count / reconstruction.gaussians.count,
        **asdict(likeness(image, scene.target.image)),
        "seconds": seconds,
        "render_seconds": min(times),
        "ply_mb": size / 1e6,
    }


def against_all(scenes: Sequence[dict[str, dict[str, float]]], name: str) -> Row:
    """Means of a variant over the scenes; dB as the difference from `all` of the same scene."""
    means = {
        key: float(np.mean([scene[name][key] for scene in scenes]))
        for key in scenes[0][name]
    }
    gain = [scene[name]["psnr"] - scene["all"]["psnr"] for scene in scenes]
    return {
        "share left": (means["share"], ".3f"),
        "made in, CPU s": (means["seconds"], ".2f"),
        "rendered in, CPU ms": (1000 * means["render_seconds"], ".0f"),
        "PLY MB": (means["ply_mb"], ".1f"),
        "dB against all": (float(np.mean(gain)), "+.2f"),
        "worst": (min(gain), "+.2f"),
        **{
            title: (means[title.lower()], ".3f")
            for title in ("SSIM", "LPIPS", "detail")
        },
    }


if __name__ == "__main__":
    run_benchmark(dial, default_run, held_out, floaters, simplify)
