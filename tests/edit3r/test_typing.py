"""Types of the public names, as a user's own mypy sees them."""

from pathlib import Path

import pytest

import edit3r

SCRIPT = Path(__file__).with_name("users_script.py")


@pytest.mark.slow
def test_a_users_script_is_checked_strictly(tmp_path, monkeypatch, pytestconfig):
    """Right lines pass, and none of the comments `type: ignore`, one for each mistake, is idle."""
    from mypy import api

    monkeypatch.setenv("MYPYPATH", str(Path(edit3r.__file__).parents[1]))
    config = tmp_path / "mypy.ini"
    # torch's own types take half a minute, and none of the mistakes is one of tensors
    config.write_text("[mypy]\nstrict = True\n[mypy-torch.*]\nfollow_imports = skip\n")
    kept = pytestconfig.cache.mkdir("users_script")  # the next time takes a fifth
    options = [f"--config-file={config}", f"--cache-dir={kept}"]
    said, _, code = api.run([*options, str(SCRIPT)])
    assert code == 0, said


def test_the_public_names_are_told_to_type_checkers():
    assert all(getattr(edit3r, name) is not None for name in edit3r.__all__)
    assert Path(edit3r.__file__).with_name("py.typed").is_file()
