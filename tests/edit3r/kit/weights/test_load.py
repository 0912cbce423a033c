"""Loading foreign weights: what is said when it fails, and what is noted when it works."""

import logging

import pytest
import torch

from edit3r.contract.errors import (
    InputError,
    MissingDependencyError,
    RunError,
    SettingsError,
)
from edit3r.kit.weights.load import (
    ChosenWeights,
    foreign,
    identity,
    load_pretrained,
    out_of_memory_told,
    pick_device,
    quiet,
)


class Model:
    """Stands in for a foreign class: remembers what it was asked for, or raises."""

    error: Exception | None = None

    @classmethod
    def from_pretrained(cls, model, **given):
        if cls.error is not None:
            raise cls.error
        return model, given


class Missing(Model):
    error = OSError("no such repository")


def test_revision_and_variant_are_passed_only_when_given():
    assert load_pretrained(Model, ChosenWeights("a/b", "k")) == (
        "a/b",
        {"local_files_only": False},
    )
    _, given = load_pretrained(
        Model, ChosenWeights("a/b", "k", "v1", "fp16", True), dtype=torch.float32
    )
    assert given == {
        "local_files_only": True,
        "revision": "v1",
        "variant": "fp16",
        "dtype": torch.float32,
    }


def test_an_id_that_cannot_be_had_names_the_download_command():
    with pytest.raises(
        MissingDependencyError,
        match=r"editor\.model: 'a/b' .*no such repository.* `hf download a/b`",
    ):
        load_pretrained(Missing, ChosenWeights("a/b", "editor.model"))


@pytest.mark.parametrize(
    "model", ["/nowhere/at/all", "./nothing", "~/nothing-here", "one/two/three"]
)
def test_a_path_that_is_no_folder_is_told_before_anything_is_tried(model):
    with pytest.raises(InputError, match=r"editor\.model: no folder"):
        load_pretrained(Missing, ChosenWeights(model, "editor.model"))


def test_a_folder_of_something_else_names_what_it_should_hold(tmp_path):
    with pytest.raises(InputError, match="does not hold a Missing"):
        load_pretrained(Missing, ChosenWeights(str(tmp_path), "k"))


def test_a_folder_is_noted_without_a_commit(tmp_path):
    assert identity(ChosenWeights(str(tmp_path), "k")) == {
        "model": str(tmp_path),
        "revision": "newest",
    }


def test_auto_is_where_the_photos_are_and_nonsense_is_refused():
    assert pick_device("auto", torch.device("meta"), "k") == torch.device("meta")
    assert pick_device("cpu", torch.device("meta"), "k") == torch.device("cpu")
    with pytest.raises(
        SettingsError,
        match=r"editor\.device: 'toaster' cannot be used .*--set editor\.device=cpu",
    ):
        pick_device("toaster", torch.device("cpu"), "editor.device")


def test_only_running_out_of_memory_is_retold():
    with (
        pytest.raises(RunError, match="out of memory while baking; use a smaller cake"),
        out_of_memory_told("baking", "use a smaller cake"),
    ):
        raise RuntimeError(
            "DefaultCPUAllocator: can't allocate memory: you tried to allocate 99 bytes"
        )
    with (
        pytest.raises(RuntimeError, match="shapes differ"),
        out_of_memory_told("baking", "x"),
    ):
        raise RuntimeError("shapes differ")


@pytest.mark.parametrize(
    ("reason", "cure"),
    [
        ("operator torchvision::nms does not exist", "pip uninstall torchvision"),
        ("bad wheel", "pip install --upgrade"),
    ],
)
def test_a_library_that_is_there_but_broken_is_a_sentence_with_the_cure(
    tmp_path, monkeypatch, reason, cure
):
    (tmp_path / "broken_library.py").write_text(f"raise RuntimeError({reason!r})")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(
        MissingDependencyError,
        match=rf"broken_library\.Model does not import here .*try: {cure}",
    ):
        foreign("broken_library", "Model")


def test_quiet_restores_the_libraries_log_level():
    pytest.importorskip("transformers")
    logger = logging.getLogger("transformers")
    before = logger.level
    with quiet():
        assert logger.level == logging.ERROR
    assert logger.level == before
