"""Answers are kept by what they were made from, come back equal, and are computed again when
anything differs.
"""

import json
import warnings

import pytest
import torch
from pydantic import Field
from safetensors.torch import save

import edit3r
from edit3r import Settings
from edit3r.contract.interfaces import Geometry, Proposal, Tracks
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit.cache import Cache, fingerprint, identity, remembered, using
from edit3r_testing import second_device
from edit3r_testing.scenes import gaussian_cloud


class Doubling:
    """A component whose answer is twice what it is given."""

    class Settings(Settings):
        factor: float = Field(2.0, description="factor")

    def __init__(self, **settings):
        self.settings, self.calls = self.Settings(**settings), 0

    @remembered
    def answer(self, tensor, words="x"):
        self.calls += 1
        return self.settings.factor * tensor


def test_without_a_cache_nothing_is_remembered():
    doubling = Doubling()
    assert (
        torch.equal(doubling.answer(torch.ones(2)), doubling.answer(torch.ones(2)))
        and doubling.calls == 2
    )


def test_the_same_question_is_answered_once_and_the_answer_may_be_written_into():
    doubling = Doubling()
    with using(Cache()):
        doubling.answer(torch.ones(2)).zero_()
        assert doubling.answer(torch.ones(2)).tolist() == [2, 2] and doubling.calls == 1


@pytest.mark.parametrize(
    "question", [(torch.ones(3),), (torch.ones(2).double(),), (torch.ones(2), "y")]
)
def test_another_question_is_computed(question):
    doubling = Doubling()
    with using(Cache()):
        doubling.answer(torch.ones(2))
        doubling.answer(*question)
    assert doubling.calls == 2


def test_other_settings_are_another_component():
    assert (
        identity(Doubling())
        != identity(Doubling(factor=3.0))
        == identity(Doubling(factor=3.0))
    )


def test_trained_weights_are_another_component():
    doubling = Doubling()
    doubling.network = torch.nn.Linear(2, 2)
    before = identity(doubling)
    with torch.no_grad():
        doubling.network.weight[0, 0] += 1e-3
    assert identity(doubling) != before


def test_fetched_weights_make_another_component(tmp_path, monkeypatch):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    component = edit3r.build("segmenter", "grabcut")
    without = identity(component)
    assert identity(component) == without
    weights = component.offer.component.weights[0]
    (tmp_path / weights.name).mkdir()
    for path, _ in weights.files:
        (tmp_path / weights.name / weights.stored(path)).touch()
    assert identity(component) != without


def test_names_of_views_change_no_fingerprint_and_pixels_do():
    images, lens = torch.rand(1, 2, 3, 4, 4), torch.eye(3).expand(1, 2, 3, 3)
    assert fingerprint(Views(images, lens, ("a", "b"))) == fingerprint(
        Views(images, lens)
    )
    assert fingerprint(Views(images, lens)) != fingerprint(Views(images + 1e-7, lens))


MAPS = torch.rand(1, 2, 3, 3)
GAUSSIANS = gaussian_cloud(5)
ANSWERS = {
    "geometry": Geometry(torch.rand(1, 2, 4, 4), MAPS, MAPS, torch.ones(1, 2) > 0),
    "proposals": (Proposal(torch.rand(3, 3), 0.5),),
    "no proposals": (),
    "cannot read": None,
    "tracks": Tracks(torch.rand(2, 1, 3, 3), torch.ones(2, 1) > 0),
    "scene": Reconstruction(
        GAUSSIANS, Cameras(torch.rand(1, 2, 4, 4), torch.rand(1, 2, 3, 3), (3, 4))
    ),
}


@pytest.mark.parametrize("answer", ANSWERS.values(), ids=ANSWERS)
def test_an_answer_comes_back_equal_from_files(answer, tmp_path):
    cache = Cache()
    cache.recall("stage", "key", lambda: answer)
    cache.save(tmp_path)
    found = Cache(tmp_path)
    again = found.recall("stage", "key", lambda: pytest.fail("computed again"))
    assert fingerprint(again) == fingerprint(answer) and type(again) is type(answer)
    assert found.reused == ["stage"] and found.computed == []


def test_an_answer_that_was_never_kept_is_computed_without_a_warning(tmp_path):
    with warnings.catch_warnings(action="error"):
        assert Cache(tmp_path).recall("stage", "key", lambda: "anew") == "anew"


def test_only_what_was_asked_for_is_written_again(tmp_path):
    cache = Cache()
    for key in ("a", "b"):
        cache.recall("stage", key, lambda: torch.ones(1))
    cache.save(tmp_path / "one")
    second = Cache(tmp_path / "one")
    second.recall("stage", "a", lambda: pytest.fail("computed again"))
    second.save(tmp_path / "two")
    assert [file.name for file in (tmp_path / "two").iterdir()] == [
        "stage-a.safetensors"
    ]


def kept(folder):
    """The file of one answer."""
    cache = Cache()
    cache.recall("stage", "key", lambda: (torch.arange(64.0), "text"))
    cache.save(folder)
    return folder / "stage-key.safetensors"


def computed_anew(folder, told):
    expected = rf"stage-key.safetensors: cannot be read .*{told}.* computed again"
    with pytest.warns(UserWarning, match=expected):
        assert Cache(folder).recall("stage", "key", lambda: "anew") == "anew"


@pytest.mark.parametrize("content", [b"", b"nothing", b"\xff" * 100])
def test_a_damaged_entry_is_named_and_computed_anew(content, tmp_path):
    kept(tmp_path).write_bytes(content)
    computed_anew(tmp_path, "")


@pytest.mark.parametrize("part", [b"text", torch.arange(64.0).numpy().tobytes()])
def test_an_entry_with_a_flipped_bit_is_not_used(part, tmp_path):
    file = kept(tmp_path)
    content = bytearray(file.read_bytes())
    content[content.index(part) + len(part) - 1] ^= 1
    file.write_bytes(content)
    computed_anew(tmp_path, "its checksum does not match")


def test_an_entry_that_names_another_class_is_not_used(tmp_path):
    tree = {"class": "Popen", "fields": {"args": "true"}}
    text = json.dumps({"tree": tree, "checksum": fingerprint(tree, {})})
    content = {"tree": torch.tensor(list(text.encode()), dtype=torch.uint8)}
    kept(tmp_path).write_bytes(save(content))
    computed_anew(tmp_path, "Popen")


@pytest.mark.parametrize(
    "other",
    [
        torch.zeros(2, 2),
        torch.zeros(4, 1),
        torch.zeros(4, dtype=torch.int32),
        torch.zeros(2, dtype=torch.float64),
        torch.zeros(8, dtype=torch.bfloat16),
    ],
)
def test_the_key_of_a_tensor_holds_its_type_and_shape(other):
    """All of these are the same sixteen bytes."""
    zeros = torch.zeros(4)
    assert fingerprint(zeros) == fingerprint(zeros.clone())
    assert fingerprint(zeros) != fingerprint(other)


def test_an_answer_is_given_on_the_device_of_what_was_asked_about():
    component = Doubling()
    with second_device() as device, using(Cache()):
        for where in (torch.device("cpu"), device, device):
            answer = component.answer(torch.ones(2).to(where))
            assert answer.device == where and answer.tolist() == [2, 2]
    assert component.calls == 1
