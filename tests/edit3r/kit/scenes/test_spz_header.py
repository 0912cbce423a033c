"""SPZ by hand, as its format's description has it, and by the library of those who made it."""

import gzip
import json
import shutil
import struct
import subprocess
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.rotations import matrices_to_quats, quats_to_matrices
from edit3r.kit.scenes.reading import load_scene

pytest.importorskip("gaussforge", reason="needs the extra export")

FRAMES = [
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
]
"""As the extension SPZ_ADOBE_coordinate_system numbers them, from 1."""
OURS = {"R": (1, 0, 0), "D": (0, 1, 0), "F": (0, 0, 1)}
OPPOSITE = {"L": "R", "U": "D", "B": "F"}


def scene(count=40, degree=0):
    generator = torch.Generator().manual_seed(0)
    coefficients = (degree + 1) ** 2
    return Gaussians(
        torch.randn(1, count, 3, generator=generator) + torch.tensor([0, 0, 5.0]),
        0.05 + 0.2 * torch.rand(1, count, 3, generator=generator),
        torch.nn.functional.normalize(
            torch.randn(1, count, 4, generator=generator), dim=-1
        ),
        0.2 + 0.7 * torch.rand(1, count, generator=generator),
        0.3 * torch.randn(1, count, coefficients, 3, generator=generator),
    )


def axes_of(frame):
    """Rows: the file's axes in ours."""
    rows = []
    for letter in frame:
        sign = -1 if letter in OPPOSITE else 1
        rows.append(sign * np.array(OURS[OPPOSITE.get(letter, letter)]))
    return np.stack(rows).astype(float)


def in_axes(gaussians, axes):
    """A scene of degree 0 as other axes see it, which may be mirrored."""
    turns = np.linalg.det(axes) * axes @ quats_to_matrices(gaussians.quats[0]).numpy()
    quats = matrices_to_quats(torch.from_numpy(turns).float())[None]
    means = gaussians.means @ torch.from_numpy(axes.T).float()
    return replace(gaussians, means=means, quats=quats)


def quantised(values, factor, offset, kind=np.uint8):
    return np.rint(values * factor + offset).clip(0, 255).astype(kind).tobytes()


def spz(version, gaussians, frame="RUB"):
    """The file that holds a scene of degree 0 in the axes `frame`, by the description."""
    gaussians, n = in_axes(gaussians, axes_of(frame)), gaussians.count
    means = gaussians.means[0].numpy()
    w, x, y, z = gaussians.quats[0].numpy().T
    head = struct.pack("<4sIIBBBB", b"NGSP", version, n, 0, 12, 2 * (frame != "RUB"), 0)
    if version == 1:
        places = means.astype("<f2").tobytes()
    else:
        steps = np.rint(means * 4096).astype("<i4")
        places = steps.view(np.uint8).reshape(n, 3, 4)[..., :3].tobytes()
    body = places + quantised(gaussians.opacities[0].numpy(), 255, 0)
    body += quantised(gaussians.harmonics[0, :, 0].numpy(), 0.15 * 255, 127.5)
    body += quantised(np.log(gaussians.scales[0].numpy()), 16, 160)
    if version < 3:
        sign = np.where(w < 0, -1, 1)[:, None]
        body += quantised(np.stack((x, y, z), 1) * sign, 127.5, 127.5)
    else:
        body += b"".join(smallest_three(q) for q in np.stack((x, y, z, w), 1))
    if frame != "RUB":
        body += struct.pack("<III", 0x12340001, 4, 7)  # of somebody else
        body += struct.pack("<III", 0xADBE0003, 4, FRAMES.index(frame) + 1)
    return gzip.compress(head + body)


def smallest_three(quaternion):
    largest = int(abs(quaternion).argmax())
    quaternion = quaternion * np.sign(quaternion[largest])
    word = largest
    for index in range(4):
        if index != largest:
            size = round(511 * min(abs(quaternion[index]) * 2**0.5, 1))
            word = word << 10 | (quaternion[index] < 0) << 9 | size
    return struct.pack("<I", word)


def seen(gaussians):
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])[None, None]
    camera = Cameras(torch.eye(4)[None, None], lens, (48, 48))
    return edit3r.build("rasterizer", "torch").render(gaussians, camera).images


def look_alike(first, second):
    difference = (seen(first) - seen(second)).abs()
    return difference.max() < 0.06 and difference.mean() < 0.006


@pytest.mark.parametrize(
    ("version", "frame"),
    [*product((1, 2, 3), ["RUB"]), *product((3,), FRAMES), (1, "LUF"), (2, "RFU")],
)
def test_a_file_made_by_the_description_is_read_upright(tmp_path, version, frame):
    made = scene()
    (tmp_path / "s.spz").write_bytes(spz(version, made, frame))
    read = load_scene(tmp_path / "s.spz")
    torch.testing.assert_close(read.means, made.means, atol=3e-3, rtol=1e-3)
    assert look_alike(read, made)


GOOD = spz(3, scene())
BAD = {
    "cut off": GOOD[:-40],
    "cut off in its header": GOOD[:20],
    "too short a body": gzip.compress(gzip.decompress(GOOD)[:-10]),
    "other version": gzip.compress(b"NGSP\x09" + gzip.decompress(GOOD)[5:]),
    "damaged": GOOD[:60] + bytes(60) + GOOD[120:],
    "of version 4, cut off": b"NGSP"
    + struct.pack("<IIBBBBI", 4, 9, 0, 12, 0, 6, 32)
    + bytes(40),
    "unknown axes": gzip.compress(
        gzip.decompress(spz(3, scene(), "LUF"))[:-4] + struct.pack("<I", 99)
    ),
    "harmonics of degree 9": gzip.compress(
        gzip.decompress(GOOD)[:12] + b"\x09" + gzip.decompress(GOOD)[13:]
    ),
}


@pytest.mark.parametrize("content", BAD.values(), ids=BAD)
def test_a_damaged_file_is_called_damaged(tmp_path, content):
    (tmp_path / "s.spz").write_bytes(content)
    with pytest.raises(InputError, match=r"s\.spz: .*damaged"):
        load_scene(tmp_path / "s.spz")


# The library of Niantic and Adobe, which splat-transform brings along

OFFICIAL = """
import { pathToFileURL } from 'url';
import { readFileSync, writeFileSync } from 'fs';
const job = JSON.parse(readFileSync(0));
const spz = await (await import(pathToFileURL(job.library))).default();
const axes = spz.CoordinateSystem;
const names = ['positions', 'scales', 'rotations', 'alphas', 'colors', 'sh'];
if (job.read) {
  const found = spz.loadSpzFromBuffer(new Uint8Array(readFileSync(job.read)), {to: axes.RDF});
  const answer = {degree: found.shDegree};
  for (const name of names) answer[name] = Array.from(found[name]);
  console.log(JSON.stringify(answer));
} else {
  const cloud = {numPoints: job.count, shDegree: job.degree, antialiased: false, extensions: []};
  for (const name of names) cloud[name] = new Float32Array(job[name]);
  const options = {version: job.version, from: axes.RDF, sh1Bits: 8, shRestBits: 8};
  writeFileSync(job.write, spz.saveSpzToBuffer(cloud, options));
}
"""


def official(tmp_path, **job):
    program = shutil.which("splat-transform")
    found = [
        folder / "@adobe/spz/dist/spz.js"
        for folder in (Path(program).resolve().parents if program else ())
    ]
    found += [file.parent / "node_modules" / file for file in found]
    library = next((file for file in found if file.is_file()), None)
    if library is None:
        pytest.skip("needs splat-transform: npm install -g @playcanvas/splat-transform")
    (tmp_path / "official.mjs").write_text(OFFICIAL)
    done = subprocess.run(
        ["node", tmp_path / "official.mjs"],
        input=json.dumps({**job, "library": str(library)}),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    return json.loads(lines[-1]) if lines else None


def columns(gaussians):
    """A scene as the library has it: logarithms, logits, quaternions xyzw."""
    values = {
        "positions": gaussians.means[0],
        "scales": gaussians.scales[0].log(),
        "rotations": gaussians.quats[0][:, [1, 2, 3, 0]],
        "alphas": gaussians.opacities[0].logit(),
        "colors": gaussians.harmonics[0, :, 0],
        "sh": gaussians.harmonics[0, :, 1:],
    }
    return {name: each.flatten().tolist() for name, each in values.items()}


def read_officially(tmp_path, file):
    theirs = official(tmp_path, read=str(file))
    names = ("positions", "scales", "rotations", "alphas", "colors", "sh")
    count = len(theirs["alphas"])
    rest = (theirs["degree"] + 1) ** 2 - 1
    shapes = (
        (count, 3),
        (count, 3),
        (count, 4),
        (count,),
        (count, 1, 3),
        (count, rest, 3),
    )
    rows = [
        torch.tensor(theirs[name]).reshape(1, *shape)
        for name, shape in zip(names, shapes)
    ]
    means, scales, quats, opacities, colours, further = rows
    harmonics = torch.cat((colours, further), 2)
    quats = quats[..., [3, 0, 1, 2]]
    return Gaussians(means, scales.exp(), quats, opacities.sigmoid(), harmonics)


@pytest.mark.slow
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("version", [2, 3, 4])
def test_what_the_official_library_writes_is_read_upright(tmp_path, version, degree):
    made, file = scene(degree=degree), tmp_path / "s.spz"
    made = replace(made, harmonics=0.7 * made.harmonics)  # it cuts at 1
    job = {"write": str(file), "version": version, "count": made.count}
    official(tmp_path, **job, degree=degree, **columns(made))
    read = load_scene(file)
    torch.testing.assert_close(read.means, made.means, atol=3e-4, rtol=0)
    torch.testing.assert_close(read.harmonics, made.harmonics, atol=0.02, rtol=0)
    assert look_alike(read, made)


@pytest.mark.slow
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("form", ["spz", "spz4"])
def test_the_official_library_reads_what_is_written_upright(tmp_path, form, degree):
    made, file = scene(degree=degree), tmp_path / "s.spz"
    made = replace(made, harmonics=0.7 * made.harmonics)
    edit3r.build("writer", form).write(file, SceneToWrite(made))
    read = read_officially(tmp_path, file)
    assert read.degree == degree
    torch.testing.assert_close(read.means, made.means, atol=3e-4, rtol=0)
    torch.testing.assert_close(read.harmonics, made.harmonics, atol=0.08, rtol=0)
    assert look_alike(read, made)


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_the_official_library_reads_files_made_by_the_description(tmp_path, version):
    """As the tests above make them."""
    made, file = scene(), tmp_path / "s.spz"
    file.write_bytes(spz(version, made))
    assert look_alike(read_officially(tmp_path, file), made)


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["LUF", "RDF", "LDB", "RFU", "LBD"])
def test_axes_mean_to_the_official_library_what_they_mean_here(tmp_path, frame):
    """In version 4; of older ones it passes over extensions."""
    made, file = scene(), tmp_path / "s.spz"
    stored = in_axes(made, axes_of("RUB").T @ axes_of(frame))
    job = {"write": str(file), "version": 4, "count": made.count, "degree": 0}
    official(tmp_path, **job, **columns(stored))
    content = bytearray(file.read_bytes())
    record = struct.pack("<III", 0xADBE0003, 4, FRAMES.index(frame) + 1)
    content[14] |= 2
    content[16:20] = struct.pack("<I", 32 + len(record))
    file.write_bytes(content[:32] + record + content[32:])
    assert look_alike(read_officially(tmp_path, file), made)
    assert look_alike(load_scene(file), made)
