import json

import numpy as np
import pytest
from PIL import Image
from pydantic import Field, SecretStr

from edit3r.contract.reporting import StageRecord
from edit3r.contract.settings import Settings
from edit3r.contract.verdicts import Verdict
from edit3r.kit.photos.images import load_photos
from edit3r.running.run_folder import RunFolder


class RemoteSettings(Settings):
    api_key: SecretStr = Field(SecretStr("sk-live-123"), description="key")
    strength: float = Field(0.5, description="how much")


@pytest.fixture
def manifest(tmp_path):
    Image.fromarray(np.zeros((30, 40, 3), np.uint8)).save(tmp_path / "a.png")
    return dict(
        prompt="paint it grün",
        seed=3,
        device="cpu",
        settings={
            "editor": RemoteSettings(),
            "alpha": {"token": "hf_456", "tokens": 7, "key_frames": "all"},
        },
        plugins=[{"kind": "editor", "licence": "Apache-2.0"}],
        inputs=load_photos(tmp_path / "a.png", fov=60).photos,
        masks={},
        weights=[{"file": "small.safetensors"}],
        verdict=Verdict(
            "good",
            "well",
            (30.0, None),
            (25.0, None),
            (True, False),
            (1.0, None),
            (0.1, None),
            (0.2, None),
            (0.3, None),
        ),
        edit_verdict=None,
        selection_verdict=None,
        gaussians=131072,
        harmonics_degree=0,
        stages=[StageRecord("edit", 1.5, 1.25, 300.0)],
        warnings=["a warning"],
        notes={"z": float("inf"), "a": np.float32(0.5), "b": [1, (2, 3)]},
    )


def written(tmp_path, manifest):
    RunFolder(tmp_path).write_manifest(manifest)
    return (tmp_path / "run.json").read_text(encoding="utf-8")


def test_manifest_says_what_was_run(tmp_path, manifest):
    content = json.loads(written(tmp_path, manifest))
    assert (
        content["prompt"] == "paint it grün"
        and content["seed"] == 3
        and content["gaussians"] == 131072
    )
    assert content["plugins"][0]["licence"] == "Apache-2.0"
    photo = content["inputs"][0]
    assert (
        photo["intrinsics_source"] == "--fov 60"
        and photo["size"] == [30, 40]
        and len(photo["sha256"]) == 64
    )
    assert photo["frame"]["target"] == [30, 40]
    assert content["stages"][0] == {
        "name": "edit",
        "seconds": 1.5,
        "cpu_seconds": 1.25,
        "peak_memory_mb": 300.0,
    }
    assert (
        content["versions"]["torch"]
        and content["versions"]["python"]
        and content["versions"]["edit3r"]
    )


def test_secrets_are_never_written(tmp_path, manifest):
    text = written(tmp_path, manifest)
    assert "sk-live-123" not in text and "hf_456" not in text
    settings = json.loads(text)["settings"]
    assert settings["editor"]["strength"] == 0.5
    assert settings["alpha"]["tokens"] == 7 and settings["alpha"]["key_frames"] == "all"


def test_manifest_is_strict_json_in_a_stable_order(tmp_path, manifest):
    text = written(tmp_path, manifest)
    content = json.loads(
        text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON")
    )
    assert content["notes"] == {"a": 0.5, "b": [1, [2, 3]], "z": None}
    assert list(content)[:3] == ["prompt", "seed", "device"] and list(
        content["notes"]
    ) == ["a", "b", "z"]
    assert text == written(tmp_path, manifest)


def test_what_stays_true_of_a_run_goes_on_without_what_lies_behind_its_links(tmp_path):
    before = tmp_path / "run"
    before.mkdir()
    (before / "cameras.json").write_text("[]")
    (before / "inputs").mkdir()
    (before / "inputs" / "a.png").write_bytes(b"photo")
    private = tmp_path / "private"
    private.mkdir()
    (private / "secret.txt").write_bytes(b"secret")
    (before / "inputs" / "b.png").symlink_to(private / "secret.txt")
    (before / "edited").symlink_to(private)
    after = tmp_path / "after"
    after.mkdir()
    RunFolder(after).continue_from(
        before, ("inputs", "edited", "masks"), {"objects": {"ä": 1}}
    )
    assert (after / "inputs" / "a.png").read_bytes() == b"photo"
    assert (after / "inputs" / "b.png").is_symlink()
    assert not (after / "edited").exists()
    assert not (after / "masks").exists()
    assert json.loads((after / "run.json").read_text("utf-8")) == {"objects": {"ä": 1}}
    assert (after / "cameras.json").read_text() == "[]"
