import subprocess
import sys

from numba.core import caching

from edit3r.compute.compiling import compiled
from edit3r.reporting import Report, collecting

MODULE = """
from edit3r.compute.compiling import compiled

@compiled(nogil=True)
def twice(value):
    return 2 * value

print(twice(21), sum(twice.stats.cache_hits.values()))
"""


def run(module):
    return subprocess.run(
        [sys.executable, module], capture_output=True, text=True, check=False
    )


def test_compiled_code_is_kept_and_damage_to_it_is_mended(tmp_path):
    module = tmp_path / "module.py"
    module.write_text(MODULE)
    assert run(module).stdout == "42 0\n" and run(module).stdout == "42 1\n"
    for kind in ("*.nbi", "*.nbc"):
        (kept,) = (tmp_path / "__pycache__").glob(kind)
        for content in (b"", kept.read_bytes()[:-40], b"\x80\x04garbage"):
            kept.write_bytes(content)
            done = run(module)
            assert (done.stdout, done.stderr) == ("42 0\n", ""), (kind, content[:10])
    assert run(module).stdout == "42 1\n"


def test_without_a_writable_folder_there_is_one_warning(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    functions = [
        compiled(nogil=True)(lambda value: value + 1) for _ in range(2)
    ]  # as modules are loaded
    with collecting(Report()) as report:
        assert [function(1) for function in functions] == [2, 2]
    assert len(report.warnings) == 1 and "NUMBA_CACHE_DIR" in report.warnings[0]


def test_a_full_disk_is_no_error(monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caching.FunctionCache, "save_overload", full)
    assert compiled(nogil=True)(lambda value: value + 1)(1) == 2
