"""In which unit a scene stands in a file whose format holds some positions only.

SPZ counts in steps of 1/4096 from -2048 to 2048, SOG in steps that grow with the distance from the
origin, and others compute with float32 far from it. A scene in millimetres or in the coordinates of
a map is brought into a unit that fits. What was done stands in the file, where other programs pass
over it, and `edit3r.kit.scenes.placement` undoes it on reading.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float64

from edit3r.contract.errors import InputError
from edit3r.contract.types import Gaussians
from edit3r.kit.scenes.axes import LEAST_OPACITY
from edit3r.kit.scenes.placement import FilePlacement

# The numbers of this block: no figures kept.
SPZ_RANGE = 2047.0  # the format
SPZ_STEP = 1 / 4096
# size of a Gaussian: its logarithm is kept from -10 to 5.9; the format
SPZ_LARGEST = 300.0
SOG_STEPS = 65535  # of the logarithms of positions, from the least to the most
SMALLEST_EXTENT = 1e-3  # gaussforge takes less for nothing
GOOD = 4.0  # steps a Gaussian, as most scenes have: beyond it, images hardly change
LEAST = 2.0  # steps below which a file would not show the scene
EXTENTS = (16.0, 256.0, SPZ_RANGE - 1)  # that a scene may be given, small ones first
FEW = 0.1  # share of the Gaussians that may have fewer steps
# share on each side of an axis that may be left out, where all would not fit
FAR = 0.005
SPZ_LIST = 16  # where an SPZ 4 says it [bytes]
_COMMENT = 0x10  # flag of a gzip stream with a comment
Positions = Float64[np.ndarray, "gaussian 3"]


def placed(gaussians: Gaussians, placement: FilePlacement) -> Gaussians:
    """The scene (batch 1) as it stands in the file."""
    means = gaussians.means.double() - torch.tensor(placement.centre).double()
    return replace(
        gaussians,
        means=(means * placement.factor).float(),
        scales=gaussians.scales * placement.factor,
    )


def fitting(gaussians: Gaussians, form: str) -> tuple[Gaussians, FilePlacement]:
    """The Gaussians that a file of this form can hold, and where they stand in it.

    Usually all, and where they are. Raises InputError where no unit fits.
    """
    steps_of = _STEPS[form]
    drawn = (gaussians.opacities[0] >= LEAST_OPACITY).cpu().numpy()
    everything = gaussians.means[0].detach().double().cpu().numpy()
    sizes = gaussians.scales[0].detach().double().amax(1).cpu().numpy()
    if not drawn.any():
        return gaussians, FilePlacement()
    low, high = np.quantile(everything[drawn], (FAR, 1 - FAR), axis=0)
    reach = 2 * (high - low).max()  # also of what lies a little further out
    near = (abs(everything - (low + high) / 2) <= reach).all(1)
    best = (0.0, FilePlacement(), drawn)
    for kept in (drawn, drawn & near):
        for placement in _placements(everything[kept]):
            means = (everything[kept] - placement.centre) * placement.factor
            steps = steps_of(means, sizes[kept] * placement.factor)
            best = max(best, (steps, placement, kept), key=lambda one: one[0])
            if steps >= GOOD:
                break
        if best[0] >= GOOD:
            break
    steps, placement, kept = best
    if steps < LEAST:
        raise InputError(
            f"{form}: cannot hold this scene in any unit; its Gaussians are too small for its "
            "extent. Export to ply, splat or glb."
        )
    lost = drawn & ~kept
    if not lost.any():
        return gaussians, placement
    return gaussians.select(torch.from_numpy(~lost)), placement


def _placements(means: Positions) -> Iterator[FilePlacement]:
    yield FilePlacement()
    low, high = means.min(0), means.max(0)
    middle = (low + high) / 2
    # Rounded, so that people can read it and it costs no bit.
    digits = -int(np.floor(np.log10(max((high - low).max(), 1e-30)))) + 1
    x, y, z = (float(np.round(value, digits)) + 0.0 for value in middle)
    centre = (x, y, z)
    yield FilePlacement(1.0, centre)
    for place in ((0.0, 0.0, 0.0), centre):
        extent = abs(means - place).max()
        for wanted in EXTENTS:
            factor = 2.0 ** np.floor(np.log2(wanted / max(extent, 1e-30)))
            yield FilePlacement(float(factor), place)


def _spz_steps(means: Positions, sizes: Float64[np.ndarray, "gaussian"]) -> float:
    if abs(means).max() > SPZ_RANGE or np.quantile(sizes, 1 - FEW) > SPZ_LARGEST:
        return 0.0
    return float(np.quantile(sizes, FEW) / SPZ_STEP)


def _sog_steps(means: Positions, sizes: Float64[np.ndarray, "gaussian"]) -> float:
    if np.ptp(means, axis=0).max() < SMALLEST_EXTENT:
        return 0.0
    levels = np.sign(means) * np.log1p(abs(means))
    # The logarithms are computed in float32.
    step = np.maximum(np.ptp(levels, axis=0) / SOG_STEPS, 4 * _spacing(levels))
    return float(np.quantile(sizes / (step * (1 + abs(means))).max(1), FEW))


def _chunk_steps(means: Positions, sizes: Float64[np.ndarray, "gaussian"]) -> float:
    if np.ptp(means, axis=0).max() < SMALLEST_EXTENT:
        return 0.0
    return float(np.quantile(sizes / _spacing(means).max(1), FEW))


def _spacing(values: Positions) -> Positions:
    """Steps of float32 around the values."""
    return np.spacing(np.maximum(abs(values), 1e-9).astype(np.float32)).astype(float)


_STEPS: dict[str, Callable[[Positions, Float64[np.ndarray, "gaussian"]], float]] = {
    "spz": _spz_steps,
    "sog": _sog_steps,
    "compressed.ply": _chunk_steps,
}


def with_placement(content: bytes, form: str, placement: FilePlacement) -> bytes:
    """A file's content with its placement, where programs that do not know it pass over it."""
    text = placement.text
    if form == "compressed.ply":
        start, format_line, rest = content.partition(
            b"\nformat binary_little_endian 1.0\n"
        )
        return start + format_line + b"comment " + text + b"\n" + rest
    if form == "sog":  # an archive ends with the length of its comment, and the comment
        return content[:-2] + len(text).to_bytes(2, "little") + text
    if content.startswith(b"\x1f\x8b"):
        flags = bytes([content[3] | _COMMENT])
        return content[:3] + flags + content[4:10] + text + b"\0" + content[10:]
    # SPZ 4 says in its header where the list of its streams begins
    (begin,) = struct.unpack_from("<I", content, SPZ_LIST)
    return b"".join(
        (
            content[:SPZ_LIST],
            struct.pack("<I", begin + len(text)),
            content[SPZ_LIST + 4 : begin],
            text,
            content[begin:],
        )
    )
