import os

import pytest

from edit3r.kit.files.text import read_plain


def test_text_comes_from_files_alone_and_a_pipe_is_told_at_once(tmp_path):
    (tmp_path / "a.json").write_text("\u0444", "utf-8")
    assert read_plain(tmp_path / "a.json") == "\u0444"
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.json")
    for name in ("pipe.json", "none.json", "."):
        with pytest.raises(OSError, match="no such file"):
            read_plain(tmp_path / name)
