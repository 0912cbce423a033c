import shlex
import shutil
import sys
import time
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from edit3r_editors.command import parse_command

from edit3r.contract.errors import RunError, SettingsError
from edit3r.contract.types import EditRequest, Views
from edit3r.loading.registry import build
from edit3r_testing import EditorContract

VIEWS = Views(
    torch.rand(1, 2, 3, 6, 8), torch.eye(3).expand(1, 2, 3, 3), ("left", "right")
)

INVERT = """
import sys
from PIL import Image, ImageOps
ImageOps.invert(Image.open(sys.argv[1])).save(sys.argv[2])
"""
INVERT_FOLDER = """
import sys
from pathlib import Path
from typing import ClassVar
from PIL import Image, ImageOps
for file in Path(sys.argv[1]).iterdir():
    ImageOps.invert(Image.open(file)).save(Path(sys.argv[2]) / file.name)
"""


def program(tmp_path: Path, code: str, arguments: str) -> str:
    script = tmp_path / "a tool.py"
    script.write_text(code)
    return f"{shlex.quote(sys.executable)} {shlex.quote(str(script))} {arguments}"


def edit(
    command: str, prompt: str = "", seed: int = 0, masks=None, **settings
) -> torch.Tensor:
    return (
        build("editor", "command", command=command, **settings)
        .edit(VIEWS, EditRequest(prompt, seed, masks))
        .images
    )


@pytest.mark.parametrize(
    "code, arguments",
    [(INVERT, "{input} {output}"), (INVERT_FOLDER, "{input_dir} {output_dir}")],
)
def test_the_program_edits_each_view(tmp_path, code, arguments):
    edited = edit(program(tmp_path, code, arguments))
    assert torch.allclose(edited, 1 - VIEWS.images, atol=1 / 255)


def test_prompt_and_seed_arrive_as_they_are_and_no_shell_reads_them(tmp_path):
    said = tmp_path / "said.txt"
    code = f"import sys; open({str(said)!r}, 'w').write(repr(sys.argv[3:]))" + INVERT
    prompt = """it's "red"; rm -rf $HOME {seed} && echo"""
    edit(
        program(tmp_path, code, "{input} {output} {prompt} --seed={seed}"),
        prompt,
        seed=7,
    )
    assert said.read_text() == repr([prompt, "--seed=7"])


@pytest.mark.slow
def test_the_mask_is_given_as_a_picture(tmp_path):
    code = (
        "import sys\nfrom PIL import Image\nImage.open(sys.argv[1]).save(sys.argv[2])"
    )
    masks = torch.zeros(1, 2, 6, 8)
    masks[:, 1, :3] = 1
    command = program(tmp_path, code, "{mask} {output}")
    assert torch.equal(
        edit(command, masks=masks), masks[:, :, None].expand(1, 2, 3, 6, 8)
    )
    assert (edit(command) == 1).all()


def test_a_failing_program_is_quoted(tmp_path):
    code = "import sys; sys.stderr.write('no more memory on device 3'); sys.exit(5)"
    with pytest.raises(RunError, match="exit code 5: no more memory on device 3"):
        edit(program(tmp_path, code, "{input} {output}"))


def test_the_time_limit_ends_a_program_also_when_its_children_go_on(tmp_path):
    code = (
        "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; "
        "time.sleep(20)'])"
    )
    started = time.monotonic()
    with pytest.raises(RunError, match=r"longer than 0\.5 s.*editor\.timeout"):
        edit(program(tmp_path, code, "{input} {output}"), timeout=0.5)
    # it would be 20 if the end of the child were waited for
    assert time.monotonic() - started < 15


def test_a_program_that_writes_nothing_is_an_error(tmp_path):
    with pytest.raises(RunError, match=r"did not write left\.png; it wrote nothing"):
        edit(program(tmp_path, "pass", "{input} {output}"))


def test_a_missing_program_is_an_error():
    with pytest.raises(RunError, match="no program 'no-such-tool'"):
        edit("no-such-tool {input} {output}")


@pytest.mark.parametrize(
    "command, message",
    [
        ("", "needs a program"),
        ("tool {input}", "must say where to write"),
        ("tool {input} {out}", r"unknown placeholder \{out\}"),
        ("tool {input} {output_dir}", "do not go with their _dir forms"),
        ("tool 'open {input} {output}", "cannot be split"),
        ("tool {input {output}", "editor.command"),
    ],
)
def test_a_command_that_cannot_work_is_a_settings_error(command, message):
    with pytest.raises(SettingsError, match=message):
        edit(command)


def test_braces_written_twice_stay():
    arguments, together = parse_command("tool '{{\"a\": 1}}' {input} {output}")
    assert arguments[1].format() == '{"a": 1}' and not together


@pytest.mark.skipif(shutil.which("cp") is None, reason="copies files with cp")
class TestCommandKeepsTheContract(EditorContract):
    component = "command"
    settings: ClassVar = {"command": "cp {input} {output}"}
