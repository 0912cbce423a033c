import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core import caching

import edit3r
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.compute.compiling import compiled

MODULE = """
from edit3r.kit.compute.compiling import compiled

@compiled(nogil=True)
def twice(value):
    return 2 * value

print(twice(21), sum(twice.stats.cache_hits.values()))
"""


def run(module):
    return subprocess.run(
        [sys.executable, module], capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_compiled_code_is_kept_and_damage_to_it_is_mended(tmp_path):
    module = tmp_path / "module.py"
    module.write_text(MODULE)
    assert run(module).stdout == "42 0\n"
    for kind, content in (("*.nbi", b"\x80\x04garbage"), ("*.nbc", None)):
        (kept,) = (tmp_path / "__pycache__").glob(kind)
        kept.write_bytes(kept.read_bytes()[:-40] if content is None else content)
        done = run(module)
        assert (done.stdout, done.stderr) == ("42 0\n", ""), kind
    assert run(module).stdout == "42 1\n"


@pytest.mark.slow
def test_without_a_writable_folder_there_is_one_warning(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    # as modules are loaded
    functions = [compiled(nogil=True)(lambda value: value + 1) for _ in range(2)]
    with collecting(Report()) as report:
        assert [function(1) for function in functions] == [2, 2]
    assert len(report.warnings) == 1 and "NUMBA_CACHE_DIR" in report.warnings[0]


@pytest.mark.slow
def test_a_full_disk_is_no_error(monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caching.FunctionCache, "save_overload", full)
    assert compiled(nogil=True)(lambda value: value + 1)(1) == 2


TRAP = b"\x80\x04cposix\nsystem\n(V%b\ntR."  # a pickle that runs a command


@pytest.mark.slow
def test_no_compiled_code_is_read_from_the_current_folder(tmp_path):
    """numba reads its settings from there, and then pickles from a folder that they name."""
    module = tmp_path / "code" / "module.py"
    module.parent.mkdir()
    module.write_text(MODULE)
    folder = tmp_path / "stranger"
    cache = folder / "cache"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, str(module)]
    subprocess.run(command, env=environment, check=True)
    traps = list(cache.rglob("*.nbi"))
    for file in traps:
        file.write_bytes(TRAP % f"touch {tmp_path / 'ran'}".encode())
    del environment["NUMBA_CACHE_DIR"]
    (folder / ".numba_config.yaml").write_text("CACHE_DIR: cache\n")
    for named in ({}, {"NUMBA_CACHE_DIR": "cache"}):  # by the file, by the environment
        told = subprocess.run(
            command,
            env=environment | named,
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
        assert traps and not (tmp_path / "ran").exists()
        assert told.stdout.startswith("42 ") and "numba_config" not in told.stderr


def test_numba_is_imported_in_one_place():
    root = Path(edit3r.__file__).parents[1]
    for file in [*root.glob("edit3r/**/*.py"), *root.glob("plugins/**/*.py")]:
        assert not re.search(r"^ *(from|import) numba", file.read_text(), re.M), file


@pytest.mark.slow
@pytest.mark.parametrize("value", ["1", "0"])
def test_numbas_switch_for_debugging_changes_nothing(value, monkeypatch, tmp_path):
    """Kernels hold intrinsics, which only compile."""
    module = tmp_path / "module.py"
    module.write_text(MODULE)
    monkeypatch.setenv("NUMBA_DISABLE_JIT", value)
    assert run(module).stdout.startswith("42 ")
