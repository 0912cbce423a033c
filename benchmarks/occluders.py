"""What one photo alone shows before the sky: photos that no run was given, without and with looking
for the sky.

    python benchmarks/occluders.py FOLDER --photos 0,2,4 --held-out 1,3,5

A folder holds photos, and nobody knows their cameras: those of all photos together are read first.
Sets of the given photos are then reconstructed without and with `matcher.sky`. Each held-out photo
is rendered from its place beside the nearest given photo. Its pose is then drawn to the photo by
gradient descent, since the two readings differ by some pixels, and its light is fitted (gain and
offset of each channel). Printed are the verdict and the PSNR [dB] of the given photos, and of each held-out photo: of all, of its
sky, of the rest.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import torch
from edit3r_geometry.sky import find_skies

import edit3r

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


def measure(
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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
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
        measure(posed, given, held_out, {"sky": sky})


if __name__ == "__main__":
    main()
