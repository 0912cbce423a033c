"""Damaged things at every door: each is refused in one sentence that names it, or accepted with a
sound result.

`EDIT3R_FUZZ_CASES=20000 pytest tests/fuzz` tries more cases; a failure names the door and the
number of its case, and `EDIT3R_FUZZ_ONLY=pictures:17` runs that one alone.
"""

import os
import random
import re
import tempfile
import warnings
from pathlib import Path

import pytest
from doors import DOORS, _scene, make_originals
from mangling import TEXTS, json_bytes, mangled_bytes

from edit3r.cli.main import main
from edit3r.contract.errors import Edit3rError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.scenes.ply import save_ply

CASES = int(os.environ.get("EDIT3R_FUZZ_CASES", "520"))
ONLY = os.environ.get("EDIT3R_FUZZ_ONLY", "")
ESCAPED = [Path("/tmp/edit3r-escaped"), Path(tempfile.gettempdir(), "escaped")]


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    return make_originals(tmp_path_factory.mktemp("originals"))


def snapshot(folder: Path) -> dict[str, tuple[int, int]]:
    return {
        str(path): (path.lstat().st_size, path.lstat().st_mtime_ns)
        for path in folder.rglob("*")
    }


def problem_of(sentence: str) -> str:
    """What is wrong with the sentence of a refusal; "" where it is as a user needs it."""
    if not sentence.strip() or len(sentence) > 12_000:
        return "no sentence, or an endless one"
    if re.search(r"unexpected \w*(Error|Exit|Exception)|Traceback|sk-secret", sentence):
        return "says what no user should read"
    return ""


@pytest.mark.slow
@pytest.mark.parametrize("door", DOORS)
def test_every_door(door, originals, tmp_path):
    wrong, refused, seen = [], 0, snapshot(originals.folder)
    count = max(1, CASES // len(DOORS))
    wanted = ONLY.partition(":")[2] if ONLY.startswith(f"{door}:") else None
    for case in range(count) if wanted is None else [int(wanted)]:
        around = tmp_path / str(case)
        folder = around / "inside"
        folder.mkdir(parents=True)
        try:
            with collecting(Report()), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                DOORS[door](random.Random(f"{door} {case}"), folder, originals)
        except Edit3rError as error:
            refused += 1
            if problem := problem_of(str(error)):
                wrong.append(f"{door}:{case}: {problem}: {str(error)[:300]}")
            if list(folder.rglob("*partial-*")):
                wrong.append(f"{door}:{case}: left something half-written")
        except Exception as error:
            if wanted is not None:
                raise
            wrong.append(
                f"{door}:{case}: unexpected {type(error).__name__}: {str(error)[:300]}"
            )
        if [path for path in around.iterdir() if path != folder] or any(
            path.exists() for path in ESCAPED
        ):
            wrong.append(f"{door}:{case}: wrote outside of its folder")
    assert not wrong, f"{len(wrong)} of {count} cases:\n" + "\n".join(wrong[:20])
    assert snapshot(originals.folder) == seen
    assert refused < count or count < 20 or wanted is not None, (
        "not even one was accepted"
    )


def command_line(rng: random.Random, folder: Path, originals) -> list[str]:
    """One wrong or odd call of the program."""
    scene, out = folder / "scene.ply", str(folder / "out")
    scene.write_bytes(
        rng.choice(
            (
                originals.files["scene.ply"],
                mangled_bytes(rng, originals.files["scene.ply"]),
            )
        )
    )
    (folder / "cameras.json").write_bytes(
        rng.choice((json_bytes(rng, originals.trees["cameras"]), b"[]"))
    )
    (folder / "c.yaml").write_text(
        rng.choice([text for text in TEXTS if text.isascii()])
    )
    text, number = (
        rng.choice(TEXTS),
        str(rng.choice((0, -1, 1, 10**9, "nan", "9" * 5000, "x"))),
    )
    render = ["render", str(scene), "--out", out, "--quiet"]
    run = ["run", *map(str, originals.photos), "--out", out, "--quiet"]
    return rng.choice(
        (
            [*render, "--make", "pictures", "--size", rng.choice(("16", number))],
            [*render, "--make", "video", "--frames", number],
            [*render, "--make", "pictures", "--set", f"rasterizer={text}"],
            [*render, "--make", "viewer", "--set", f"rasterizer.{text or 'kind'}=1"],
            [*run, "--prompt", text, "--editor", "no-such"],
            [*run, "--seed", number, "--editor", text],
            [*run, "--size", number, "--recon", "no-such"],
            [*run, "--config", str(folder / "c.yaml"), "--editor", "no-such"],
            [*run, "--from", rng.choice((str(folder), text)), "--editor", "no-such"],
            [*run, "--set", f"{text}={number}", "--editor", "no-such"],
            [*run, "--mask", str(scene), "--device", text, "--editor", "no-such"],
            ["run", text, str(scene), "--out", out, "--quiet"],
            ["describe", text],
            [text, text],
        )
    )


@pytest.mark.slow
def test_the_program(originals, tmp_path, capsys):
    wrong = []
    for case in range(max(1, CASES // 26)):
        rng, folder = random.Random(f"program {case}"), tmp_path / str(case) / "inside"
        folder.mkdir(parents=True)
        arguments = command_line(rng, folder, originals)
        before = snapshot(folder)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                code = main(arguments)
        except SystemExit as stop:
            code = stop.code
        told = [
            line
            for line in capsys.readouterr().err.splitlines()
            if line.startswith("edit3r: ")
        ]
        shown = [argument[:80] for argument in arguments]
        if code not in (0, 1, 2) or (
            code != 0 and (len(told) != 1 or problem_of(told[0]))
        ):
            wrong.append(f"{case}: {shown}: exit {code}, {told[:2]}")
        if code != 0 and snapshot(folder) != before:
            wrong.append(f"{case}: {shown}: left {set(snapshot(folder)) - set(before)}")
        if list((tmp_path / str(case)).iterdir()) != [folder]:
            wrong.append(f"{case}: {shown}: wrote outside of its folder")
    assert not wrong, f"{len(wrong)}:\n" + "\n".join(wrong)


def test_a_sound_scene_passes(tmp_path):
    save_ply(tmp_path / "scene.ply", _scene())
    assert (
        problem_of("scene.ply: no such file.") == ""
        and problem_of("unexpected ValueError") != ""
    )
