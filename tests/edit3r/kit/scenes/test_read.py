"""Scenes of other programs: what cannot be read is one sentence."""

import pytest

from edit3r.contract.errors import InputError
from edit3r.kit.scenes import read
from edit3r.kit.scenes.read import load_scene


def test_a_damaged_file_is_one_sentence_even_where_the_library_dies_of_it(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(read, "_CONVERT", "import os; os.kill(os.getpid(), 11)")
    (tmp_path / "s.sog").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"s\.sog: cannot be read as sog"):
        load_scene(tmp_path / "s.sog")


@pytest.mark.parametrize(
    ("name", "told"), [("s.spz", "no such file"), ("s.GLB", "written but not read")]
)
def test_what_is_not_there_or_never_read_is_told(tmp_path, name, told):
    with pytest.raises(InputError, match=told):
        load_scene(tmp_path / name)
