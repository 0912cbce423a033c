"""The prompt of a run is read once, by the chosen reader, and its instructions are handed over."""

from types import SimpleNamespace

import pytest
import torch

import edit3r
from edit3r import Views
from edit3r.contract.errors import PluginError, PromptError, UnknownComponentError
from edit3r.contract.instructions import Change, Colour, Instruction, Target
from edit3r.contract.interfaces import Editor, EditsRegions, Reader, Selection
from edit3r.contract.settings import PartChoice
from edit3r.kit.photos.images import LoadedPhotos
from edit3r.loading.load import LoadedPlugins, PluginFailure
from edit3r.loading.registry import Registry
from edit3r.running import MarkTexts, preview
from edit3r.running.config import JobInputs
from edit3r.running.editors import instructions_for, read
from edit3r.running.job import RunJob, job_from

RED = Change("paint", Colour("rouge", (0.9, 0.1, 0.1)))
ALL_RED = Instruction("paint", Target("whole"), (RED,), text="rouge")
VIEWS = Views(torch.full((1, 2, 3, 8, 12), 0.5), torch.eye(3).expand(1, 2, 3, 3))


class Counting(Reader):
    """Understands everything as painting everything red."""

    def __init__(self, instructions=(ALL_RED,)):
        self.instructions, self.asked = instructions, []

    def read(self, prompt):
        self.asked.append(prompt)
        return self.instructions

    def read_target(self, words):
        self.asked.append(words)
        return Target("named", "mur", qualifiers=("left",))


class Asked(Editor, EditsRegions):
    """Notes what it is asked."""

    requests = ()

    def edit(self, views, request):
        self.requests = (*self.requests, request)
        return views


def test_the_prompt_is_read_once_and_the_editor_gets_the_instructions():
    reader, editor = Counting(), Asked()
    config = edit3r.running.RunConfig(prompt="peins tout en rouge")
    preview(RunJob(config, VIEWS, components={"reader": reader, "editor": editor}))
    assert reader.asked == ["peins tout en rouge"]
    assert [request.instructions for request in editor.requests] == [
        reader.instructions
    ]
    assert editor.requests[0].asked() == reader.instructions


def test_words_for_the_thing_are_the_readers_too():
    reader = Counting()
    photos = LoadedPhotos(VIEWS, [SimpleNamespace(frame=None)] * 2)
    selection = MarkTexts(thing="le mur").read(photos, reader)
    assert (selection.words, selection.qualifiers) == ("mur", ("left",))
    assert MarkTexts().read(photos, reader) == Selection()
    assert reader.asked == ["le mur"]


@pytest.mark.parametrize("given", ["model", {"name": "model", "timeout_s": 5}])
def test_the_reader_is_a_setting_like_the_other_parts(given):
    job = job_from(JobInputs(photos=("a.png",)), {"reader": given})
    assert job.config.reader.name == "model"
    assert job_from(JobInputs(photos=("a.png",))).config.reader.name == "grammar"


@pytest.mark.parametrize(
    ("instructions", "why"),
    [
        ((), "return an instruction"),
        ((Instruction("paint", Target(), text="red"),), "names no change"),
        (None, "tuple"),
    ],
)
def test_a_reader_that_breaks_its_contract_is_named(instructions, why):
    with pytest.raises(PluginError, match=f"Counting.*{why}"):
        read("paint it red", Counting(instructions))


def test_a_sentence_that_cannot_be_read_is_for_editors_that_take_any():
    class Any(Editor):
        def edit(self, views, request):
            return views

    assert instructions_for(Any(), "paint it red and blue") == ()
    with pytest.raises(PromptError, match="two colours"):
        instructions_for(Asked(), "paint it red and blue")


def test_a_sentence_that_nobody_can_carry_out_is_told_before_photos_are_read():
    for editor in (None, "recolor"):
        with pytest.raises(PromptError, match="'nice' in 'make it nice'"):
            edit3r.run(["no-such-file.jpg"], "make it nice", editor=editor)


def test_an_editor_without_instructions_says_how_to_get_them():
    with pytest.raises(PromptError, match=r"usual_reader\(\)\.read"):
        edit3r.EditRequest("paint it red").asked()


def test_without_any_reader_there_is_something_to_do():
    failure = PluginFailure("language", "1", "no module named 'x'")
    registry = Registry(LoadedPlugins((), (failure,)))
    told = (
        r"no installed plugin offers any reader.*'language' did not load.*pip install"
    )
    with pytest.raises(UnknownComponentError, match=told):
        registry.build_choice("reader", PartChoice(name="grammar"))
    with pytest.raises(UnknownComponentError, match=r"Did you mean 'grammar'\?"):
        edit3r.build("reader", "gramar")


def test_an_editor_of_regions_is_not_blended_by_soft_masks_a_second_time():
    class Brighter(Asked):
        def edit(self, views, request):
            weights = request.masks[:, :, None]
            return Views(views.images + 0.2 * weights, views.intrinsics)

    masks = torch.full((1, 2, 8, 12), 0.5)
    masks[..., :6] = 0
    config = edit3r.running.RunConfig(prompt="rouge")
    parts = {"reader": Counting(), "editor": Brighter()}
    made = preview(RunJob(config, VIEWS, masks=masks, components=parts))
    expected = VIEWS.images + 0.2 * masks[:, :, None]
    assert torch.equal(made.edit.views.images, expected)
