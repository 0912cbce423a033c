"""What is recorded of how a result was made."""

import pytest

from edit3r.kit import provenance
from edit3r.kit.provenance import installed_versions


def test_versions_name_only_what_is_installed():
    versions = installed_versions()
    assert all(isinstance(version, str) and version for version in versions.values())


@pytest.mark.parametrize("head", ["ref: refs/heads/main", "0123abcd"])
def test_the_commit_of_a_checkout_is_told_and_an_installed_package_has_none(
    head, tmp_path, monkeypatch
):
    home = tmp_path / "edit3r" / "kit" / "provenance.py"
    monkeypatch.setattr(provenance, "__file__", str(home))
    assert "commit" not in installed_versions()
    branch = tmp_path / ".git" / "refs" / "heads" / "main"
    branch.parent.mkdir(parents=True)
    branch.write_text("0123abcd\n")
    (tmp_path / ".git" / "HEAD").write_text(f"{head}\n")
    assert installed_versions()["commit"] == "0123abcd"
