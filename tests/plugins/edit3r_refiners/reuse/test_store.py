"""What is kept for the next run comes back bit for bit, or is refused with a sentence."""

import json

import pytest
import safetensors.torch
import torch

from edit3r.errors import InputError
from edit3r.reuse.store import VERSION, Entry, load_entry, read_key, save_entry

TENSORS = {
    "float": torch.randn(3, 5, generator=torch.Generator().manual_seed(0)),
    "odd": torch.tensor([float("nan"), float("inf"), -0.0, 1e-45]),
    "index": torch.tensor([-1, 0, 2**40]),
    "bytes": torch.arange(256).to(torch.uint8),
    "bool": torch.tensor([[True], [False]]),
    "empty": torch.zeros(0, 3),
}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "match-0.safetensors"
    save_entry(path, Entry("match", "key", TENSORS, {"words": ["ä", None, 1.5]}))
    return path


def test_an_entry_comes_back_bit_for_bit(file):
    entry = load_entry(file)
    assert (entry.stage, entry.key, entry.facts) == ("match", "key", {"words": ["ä", None, 1.5]})
    assert entry.tensors.keys() == TENSORS.keys() and read_key(file) == ("match", "key")
    for name, tensor in TENSORS.items():
        back = entry.tensors[name]
        assert back.dtype == tensor.dtype and back.shape == tensor.shape
        assert back.numpy().tobytes() == tensor.numpy().tobytes()


def test_the_same_entry_gives_the_same_bytes(file, tmp_path):
    save_entry(tmp_path / "again", Entry("match", "key", TENSORS, {"words": ["ä", None, 1.5]}))
    assert (tmp_path / "again").read_bytes() == file.read_bytes()


def test_a_type_that_is_not_kept_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ValueError, match=r"torch\.bfloat16"):
        save_entry(tmp_path / "a", Entry("match", "key", {"a": torch.zeros(2, dtype=torch.bfloat16)}))
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("kept", [0, 7, 60, 0.5, 0.99])
def test_a_file_that_was_cut_off_is_one_sentence(file, kept):
    content = file.read_bytes()
    file.write_bytes(content[: kept if kept >= 1 or kept == 0 else int(kept * len(content))])
    with pytest.raises(InputError, match=r"match-0\.safetensors: .*without --from\.$"):
        load_entry(file)


def test_a_file_whose_bytes_were_changed_is_one_sentence(file):
    content = bytearray(file.read_bytes())
    content[-3:] = b"xyz"
    file.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        load_entry(file)


def test_a_file_of_another_program_or_version_is_refused(tmp_path):
    path = tmp_path / "x.safetensors"
    safetensors.torch.save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(InputError, match="not written by edit3r"):
        read_key(path)
    header = {"edit3r-reuse": json.dumps({"version": "99", "stage": "match", "key": "k"})}
    safetensors.torch.save_file({"a": torch.zeros(1)}, path, header)
    with pytest.raises(InputError, match=f"version 99 of this layout, this edit3r reads {VERSION}"):
        read_key(path)
