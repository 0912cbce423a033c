"""The configuration of the paper's first table, run but for tiny random weights: it works, and
measures nothing. All configurations name what exists, by `edit3r_bench/test_method.py`.
"""

import json

import numpy as np
import pytest
from PIL import Image

from edit3r.cli.main import main
from edit3r.loading.registry import build

SIDE = 64


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    """One scene of three posed photos, and its five edits."""
    folder = tmp_path_factory.mktemp("scenes") / "room"
    folder.mkdir()
    drawn = {"image_size": SIDE, "context": 3, "targets": 0, "angles": (4, 5)}
    sample = build("dataset", "procedural", **drawn, seed=5)[0]
    cameras = []
    for index, image in enumerate(sample.context):
        Image.fromarray((image.permute(1, 2, 0).numpy() * 255).astype(np.uint8)).save(
            folder / f"{index}.png"
        )
        k = sample.context_cameras.intrinsics[0, index].numpy() * [[SIDE], [SIDE], [1]]
        pose = {"K": k.tolist(), "c2w": sample.context_cameras.c2w[0, index].tolist()}
        cameras.append({"file": f"{index}.png", "width": SIDE, "height": SIDE, **pose})
    (folder / "cameras.json").write_text(json.dumps(cameras))
    out = folder.parent / "bench.json"
    options = f"--labels wall --no-vetting --size {SIDE} --out {out} --quiet"
    assert main(f"bench build {folder.parent} {options}".split()) == 0
    return out


def columns(out):
    """The methods of a report, each with its failures, after reading them from the folder of a
    run.
    """
    assert main(["bench", "report", str(out), "--quiet"]) == 0
    methods = json.loads((out / "report" / "report.json").read_text())["methods"]
    return {label: method["failures"] for label, method in methods.items()}


def settings(**by_label):
    return [
        word
        for label, own in by_label.items()
        for s in own
        for word in ("--set", f"{label.replace('_', '-')}.{s}")
    ]


CHEAP = ["editor.steps=2", "editor.resolution=64", "editor.local_files_only=true"]


@pytest.mark.slow
def test_table_1_runs_with_tiny_weights(manifest, tiny, tmp_path):
    ip2p = [*CHEAP, f"editor.model={tiny.instruct_pix2pix()}"]
    control = [
        *CHEAP,
        f"editor.model={tiny.stable_diffusion()}",
        f"editor.controlnet={tiny.controlnet()}",
    ]
    fit = ["reconstructor.steps=2", "reconstructor.edit_steps=2"]
    vit = (
        "{name: asymmetric-vit, width: 48, depth: 2, heads: 2, decoder_width: 48, "
        "decoder_depth: 4, decoder_heads: 2}"
    )
    head = "{name: dpt-gaussian, feature_width: 8, point_width: 8, layer_widths: [8, 8, 16, 16]}"
    full = ["reconstructor.weights=random", "reconstructor.resolution=64"]
    full += [f"reconstructor.backbone={vit}", f"reconstructor.head={head}"]
    small = ["reconstructor.weights=untrained", "run.matcher=posed"]
    changes = settings(
        gaussctrl=[*control, "editor.matcher=posed", *fit],
        editsplat=[*ip2p, *fit],
        noposplat=[*ip2p, *full],
        edit3r=[*ip2p, *small],
        edit3r_small=[*ip2p, *small],
    )
    run = f"bench run {manifest} --config bench/main --edits 1 --no-effnet --quiet"
    assert main([*run.split(), *changes, "--out", str(tmp_path / "out")]) == 0
    methods = ["gaussctrl", "editsplat", "noposplat", "edit3r", "edit3r-small"]
    assert list(columns(tmp_path / "out")) == methods
