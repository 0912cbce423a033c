"""Photos that are hard: other light, sky and lawns, photos from wide apart.

python benchmarks/photos.py exposure|occluders|wide-sets --help
"""

import argparse
import math
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from harness import Row, for_tuning, run_benchmark
from skimage.io import imread, imsave
from skimage.transform import resize

import edit3r
from edit3r.contract.errors import MatchingError
from edit3r.kit.compute.sky import find_skies
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.kit.photos.cameras import CAMERA_FILES, PosedCamera
from edit3r.kit.photos.posed_folder import read_posed_folder

# ---- exposure ----

EXPOSURES = (1.0, 0.55, 1.5, 0.75)
BALANCES = ((1, 1, 1), (1.1, 1, 0.88), (0.92, 1, 1.08), (1.05, 1, 0.95))
SHOULDER = 0.25  # of the curve x (1 + s) / (x + s): how early it bends towards white


def exposed(image: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """The sRGB photo [height width 3] as a camera would take it with `gain` times the light."""
    linear = np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
    scene = gain * SHOULDER * linear / (1 + SHOULDER - linear)
    shown = np.clip(scene * (1 + SHOULDER) / (scene + SHOULDER), 0, 1)
    return np.where(
        shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055
    )


def take(files: list[Path], folder: Path, change: bool) -> list[Path]:
    """Write the photos of 640 pixels into the folder, exposed anew where `change`."""
    written = []
    for index, file in enumerate(files):
        image = imread(file)[..., :3] / 255
        scale = 640 / max(image.shape)
        size = (round(scale * image.shape[0]), round(scale * image.shape[1]))
        image = resize(image, size, anti_aliasing=True)
        if change:
            image = exposed(image, EXPOSURES[index] * np.array(BALANCES[index]))
        written.append(folder / f"{change}{index}.png")
        imsave(written[-1], np.uint8(255 * image + 0.5), check_contrast=False)
    return written


def exposure(
    folders: Sequence[Path], *, step: int = 2, size: int = 384
) -> Iterator[Row]:
    """Photos of one scene taken with other exposure and white balance: does the scene hold
    together?

        python benchmarks/photos.py exposure ../shared/data/fox ../shared/data/fern

    Four photos of each folder's images/ are exposed anew: their linear light is multiplied (1,
    0.55, 1.5 and 0.75 times, each with its white balance) and passes a camera's curve. Then whole
    default runs: PSNR [dB] of the finished scene at its photos, and before refining, where the
    photos agree or do not; with `--exposure own`, with `--exposure one`, and of the same photos as
    they were taken. `--step` takes every so many photos of a folder.
    """
    warnings.simplefilter("ignore")
    for folder in folders:
        files = sorted((folder / "images").iterdir())[::step][:4]
        with tempfile.TemporaryDirectory() as place:
            relit, plain = (
                take(files, Path(place), change) for change in (True, False)
            )
            for name, photos, exposure in (
                ("other light, own", relit, "own"),
                ("other light, one", relit, "one"),
                ("as taken", plain, "one"),
            ):
                result = edit3r.run(photos, editor="none", size=size, exposure=exposure)
                verdict = result.verdict
                shown, before = (
                    np.mean([one for one in values if one is not None])
                    for values in (verdict.input_psnr, verdict.agreement)
                )
                yield {
                    "scene": folder.name,
                    "run": name,
                    "verdict": verdict.label,
                    "photos [dB]": (shown, ".1f"),
                    "before refining [dB]": (before, ".1f"),
                }


# ---- occluders ----

STEPS = 70
RATE = 4e-3  # of the pose [radians, and shares of the scene's depth]


def mean_db(errors: torch.Tensor) -> float:
    return float(-10 * torch.log10(errors.mean()))


def in_its_light(image: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
    """`image` (3, height, width) with the gain and offset of each channel that suit the photo."""
    lit = []
    for own, wanted in zip(image, photo):
        known = own.detach().reshape(-1, 1)
        known = torch.cat((known, torch.ones_like(known)), 1)
        gain, offset = torch.linalg.lstsq(known, wanted.reshape(-1, 1)).solution[:, 0]
        lit.append(own * gain + offset)
    return torch.stack(lit)


def moved(change: torch.Tensor, depth: float) -> torch.Tensor:
    """The rigid transform of a change of pose: rotation vector, then shift in `depth`s."""
    x, y, z = change[:3]
    zero = torch.zeros_like(x)
    cross = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero)).view(3, 3)
    top = torch.cat((torch.linalg.matrix_exp(cross), change[3:, None] * depth), 1)
    return torch.cat((top, torch.tensor([[0.0, 0, 0, 1]])))


def aligned(
    result: edit3r.RunResult,
    pose: torch.Tensor,
    intrinsics: torch.Tensor,
    photo: torch.Tensor,
) -> torch.Tensor:
    """The rendering near `pose` that is most like the photo."""
    distances = (result.gaussians.means[0] - pose[:3, 3]).norm(dim=1)
    depth = float(distances.median())
    change = torch.zeros(6, requires_grad=True)
    optimizer = torch.optim.Adam([change], lr=RATE)
    best = photo
    least = float("inf")
    for step in range(STEPS):
        for group in optimizer.param_groups:
            group["lr"] = RATE * (1 - step / STEPS)
        there = (pose @ moved(change, depth))[None, None]
        cameras = edit3r.Cameras(there, intrinsics, tuple(photo.shape[1:]))
        image = result.rasterizer.render(result.gaussians, cameras).images[0, 0]
        image = in_its_light(image.clamp(0, 1), photo)
        loss = (image - photo).abs().mean()
        if float(loss.detach()) < least:
            least = float(loss.detach())
            best = image.detach()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return best


def measure_of_occluders(
    views: edit3r.Views, given: list[int], held_out: list[int], looked_for: dict
) -> None:
    """Print a line for the run and each held-out photo; `views` have cameras, `looked_for` are
    settings of the matcher.
    """
    alone = replace(views.select(given), c2w=None)
    size = max(views.image_size)
    result = edit3r.run(alone, editor="none", matcher=looked_for, size=size)
    placed = [given[i] for i, there in enumerate(result.verdict.placed) if there]
    truth = views.c2w[0]
    found = result.cameras.c2w[0]
    unit = torch.pdist(found[:, :3, 3]).sum() / torch.pdist(truth[placed, :3, 3]).sum()
    given_db = sum(db for db in result.verdict.input_psnr if db) / len(placed)
    print(f"{looked_for}: {result.verdict.label}, given photos {given_db:.1f} dB")
    for target in held_out:
        photo = views.images[0, target]
        near = int((truth[placed, :3, 3] - truth[target, :3, 3]).norm(dim=1).argmin())
        step = torch.linalg.inv(truth[placed[near]]) @ truth[target]
        step[:3, 3] *= unit
        image = aligned(
            result, found[near] @ step, views.intrinsics[:, [target]], photo
        )
        errors = (image - photo).square().mean(0)
        skies = find_skies([photo.permute(1, 2, 0).numpy()])
        parts = [mean_db(errors)]
        if skies is not None:
            mask = torch.from_numpy(skies[0])
            parts += [mean_db(errors[mask]), mean_db(errors[~mask])]
        print(f"  {target}: " + " ".join(f"{part:.1f}" for part in parts))


def numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


def occluders() -> None:
    """What one photo alone shows before the sky: photos that no run was given, without and with
    looking for the sky.

        python benchmarks/photos.py occluders FOLDER --photos 0,2,4 --held-out 1,3,5

    A folder holds photos, and nobody knows their cameras: those of all photos together are read
    first. Sets of the given photos are then reconstructed without and with `matcher.sky`. Each
    held-out photo is rendered from its place beside the nearest given photo. Its pose is then drawn
    to the photo by gradient descent, since the two readings differ by some pixels, and its light is
    fitted (gain and offset of each channel). Printed are the verdict and the PSNR [dB] of the given
    photos, and of each held-out photo: of all, of its sky, of the rest.
    """
    parser = argparse.ArgumentParser(
        description=occluders.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--photos", type=numbers, required=True)
    parser.add_argument("--held-out", type=numbers, required=True)
    parser.add_argument("--size", type=int, default=384)
    asked = parser.parse_args()
    files = sorted(asked.folder.iterdir())
    used = sorted({*asked.photos, *asked.held_out})
    views = edit3r.load_views([files[i] for i in used], size=asked.size)
    every = edit3r.run(views, editor="none", size=asked.size, refiners=[])
    if not all(every.verdict.placed):
        raise SystemExit("not all photos could be placed together: choose others")
    intrinsics = every.cameras.intrinsics
    posed = replace(views, c2w=every.cameras.c2w, intrinsics=intrinsics)
    position = {index: place for place, index in enumerate(used)}
    given = [position[i] for i in asked.photos]
    held_out = [position[i] for i in asked.held_out]
    for sky in (False, True):
        measure_of_occluders(posed, given, held_out, {"sky": sky})


# ---- wide_sets ----

STEP = (33.0, 47.0)  # between neighbours [degrees]
PHOTOS = 4
WRONG = 5.0
ASSUMED_FOV = 60.0


def turn_between(a: PosedCamera, b: PosedCamera) -> float:
    return degrees_of(a.c2w[:3, :3].T @ b.c2w[:3, :3])


def degrees_of(rotation: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(cv2.Rodrigues(rotation)[0])))


def row_from(cameras: Sequence[PosedCamera], start: int) -> list[int] | None:
    """A row of photos that begins with `start`; None where the folder has none."""
    row = [start]
    while len(row) < PHOTOS:
        last, middle = cameras[row[-1]], sum(STEP) / 2
        fitting = [
            (abs(turn_between(last, camera) - middle), index)
            for index, camera in enumerate(cameras)
            if STEP[0] <= turn_between(last, camera) <= STEP[1]
            and all(turn_between(cameras[i], camera) > STEP[1] for i in row[:-1])
        ]
        if not fitting:
            return None
        row.append(min(fitting)[1])
    return row


def of_unknown_lens(views: edit3r.Views) -> torch.Tensor:
    """What is assumed where nobody knows the lens."""
    height, width = views.image_size
    half = math.tan(math.radians(ASSUMED_FOV) / 2) * width / max(height, width)
    one = intrinsics_from_fov(2 * math.atan(half), views.image_size)
    return one.to(views.intrinsics).expand_as(views.intrinsics)


def result_of(
    folder: Path, row: list[int], size: int, known: bool, tilted: bool
) -> str:
    """One cell of the table: placed, wrong, largest error and seconds."""
    cameras = read_posed_folder(folder).cameras
    chosen = [cameras[index] for index in row]
    files = [folder / camera.file for camera in chosen]
    found = [folder / name for name in CAMERA_FILES if (folder / name).is_file()]
    views = edit3r.load_views(files, cameras=found[0], size=size)
    intrinsics = views.intrinsics if known else of_unknown_lens(views)
    views = edit3r.Views(
        views.images, intrinsics, views.names, assumed=(not known,) * PHOTOS
    )
    began = time.process_time()
    try:
        geometry = edit3r.build("matcher", "classical", tilted=tilted).match(views)
    except MatchingError:
        return f"refused, {time.process_time() - began:.0f} s"
    placed = torch.nonzero(geometry.registered[0]).flatten().tolist()
    errors = []
    for view in placed[1:]:
        true = chosen[0].c2w[:3, :3].T @ chosen[view].c2w[:3, :3]
        own = geometry.c2w[0, view, :3, :3].double().numpy()
        errors.append(degrees_of(own.T @ true))
    wrong = sum(error > WRONG for error in errors)
    seconds = time.process_time() - began
    return f"{len(placed)}, {wrong}, {max(errors, default=0):.1f}°, {seconds:.0f} s"


def wide_sets(
    folders: Sequence[Path], *, size: int = 512, sets: int = 3
) -> Iterator[Row]:
    """How many photos find their place where neighbours are 33 to 47 degrees apart?

        python benchmarks/photos.py wide-sets FOLDER... --size 512

    Each folder holds photos and a cameras.json with intrinsics and poses. A set is a row of four
    photos, each 33 to 47 degrees from the one before and farther from those before that one; sets
    begin at photos spread evenly over the folder, `--sets` of them. Each set is matched as it is
    and with tilted images, with the lens known and unknown. A placed photo is wrong where its turn
    relative to photo 0 is off by more than 5 degrees. Printed for every set: placed, wrong, largest
    error [degrees] and processor seconds.
    """
    for folder in for_tuning(folders):
        cameras = read_posed_folder(folder).cameras
        rows = [row_from(cameras, start) for start in range(len(cameras))]
        rows = [row for row in rows if row]
        picked = np.unique(np.linspace(0, len(rows) - 1, sets).round().astype(int))
        for row in [rows[index] for index in picked] if rows else []:
            for known in (True, False):
                yield {
                    "photos": f"{folder.name} {', '.join(map(str, row))}",
                    "lens": "known" if known else "unknown",
                    "as they are": result_of(folder, row, size, known, False),
                    "with tilted images": result_of(folder, row, size, known, True),
                }


if __name__ == "__main__":
    run_benchmark(exposure, occluders, wide_sets)
