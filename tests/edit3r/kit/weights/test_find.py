"""Weights that components declare, and where they are found."""

import pytest

from edit3r import Component
from edit3r.contract.component import KINDS
from edit3r.contract.errors import MissingDependencyError
from edit3r.contract.weights import Weights
from edit3r.kit.weights.find import find, folder
from edit3r.loading.registry import declared, default_registry

HASH = "0" * 64


def weights(**changes) -> Weights:
    given = {
        "name": "small-thing",
        "purpose": "a test",
        "size": 5,
        "licence": "MIT",
        "commercial": "yes",
        "source": "package:small-thing",
        "revision": "1.0",
        "files": (("inside/weights.bin", HASH),),
    }
    return Weights(**{**given, **changes})


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"name": "Small Thing"}, "lower-case"),
        ({"commercial": "perhaps"}, "one of yes, no, unclear"),
        ({"source": "https://example.org/file"}, "'package:NAME' or 'npm:NAME'"),
        ({"files": ()}, "names no files"),
        ({"files": (("/etc/passwd", HASH),)}, "relative path"),
        ({"files": (("inside/../../out.bin", HASH),)}, "relative path"),
        ({"files": (("weights.bin", "abc"),)}, "SHA-256"),
        ({"files": (("weights.bin", ""),)}, "every SHA-256"),
        ({"revision": ""}, "the version"),
        ({"source": "npm:small-thing", "revision": ""}, "the version"),
    ],
)
def test_a_declaration_that_could_not_be_fetched_safely_is_refused(changes, told):
    with pytest.raises(ValueError, match=told):
        weights(**changes)


def test_weights_are_found_in_the_folder_given_by_call_or_environment_and_in_no_other(
    tmp_path, monkeypatch
):
    one = weights()
    (tmp_path / "small-thing").mkdir()
    file = tmp_path / "small-thing" / "weights.bin"
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    with pytest.raises(
        MissingDependencyError,
        match=r"edit3r weights get small-thing \(MIT; commercial use: yes",
    ):
        find(one)
    file.write_bytes(b"12345")
    assert find(one) == find(one, tmp_path) == file
    with pytest.raises(MissingDependencyError):
        find(one, tmp_path / "elsewhere")


def test_weights_of_several_files_are_found_as_a_folder_and_only_when_all_are_there(
    tmp_path,
):
    two = weights(files=(("a/one.bin", HASH), ("b/two.bin", HASH)))
    (tmp_path / "small-thing").mkdir()
    (tmp_path / "small-thing" / "one.bin").touch()
    with pytest.raises(MissingDependencyError):
        find(two, tmp_path)
    (tmp_path / "small-thing" / "two.bin").touch()
    assert find(two, tmp_path) == tmp_path / "small-thing"


def test_the_folder_is_in_the_users_cache_unless_said_otherwise(monkeypatch, tmp_path):
    monkeypatch.delenv("EDIT3R_WEIGHTS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert folder() == tmp_path / "edit3r" / "weights"


def test_one_name_means_the_same_files_whoever_declares_it():
    every = [
        item
        for kind in KINDS
        for offer in default_registry().offers(kind)
        for item in offer.component.weights
    ]
    assert every
    assert all(declared()[item.name] == item for item in every)


def test_a_component_refuses_weights_of_another_type():
    with pytest.raises(ValueError, match=r"edit3r\.contract\.weights\.Weights"):
        Component("name", "module:Class", "summary", weights=("u2netp",))
