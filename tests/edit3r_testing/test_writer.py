"""The writer's contract finds every way of breaking it."""

import random
from pathlib import Path

import pytest

from edit3r.contract.component import Component, Offer
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite, Writer
from edit3r_testing import WriterContract
from edit3r_testing.contract import ContractViolation


class Spoiled(Writer):
    """Writes by a function of path and scene."""

    def __init__(self, write, suffix=".txt", needs=()):
        self._write, self.needs = write, needs
        told = {"suffix": suffix, "keeps": "nothing", "loses": "all"}
        component = Component("spoiled", "none:None", "spoils", **told)
        self.offer = Offer("writer", component, "tests", "")

    def write(self, path: Path, scene: SceneToWrite) -> None:
        self._write(path, scene)


def plainly(path, scene):
    path.write_text(f"{scene.gaussians.count}")


def beside(path, scene):
    plainly(path, scene)
    path.with_suffix(".log").write_text("done")


def by_chance(path, scene):
    path.write_text(str(random.random()))


def only_plain_colours(path, scene):
    if scene.gaussians.degree:
        raise InputError("harmonics are refused")
    plainly(path, scene)


def of_the_cameras(path, scene):
    path.write_text(str(scene.cameras.count))


def in_place(path, scene):
    scene.gaussians.means.add_(1)
    plainly(path, scene)


GIVEN = "test_writes_the_one_file_or_folder_that_it_is_given"
SAME = "test_same_scene_gives_the_same_bytes"
DEGREE = "test_takes_harmonics_of_every_degree"
NEEDS = "test_needs_what_it_says_and_no_more"
INPUTS = "test_leaves_its_inputs_alone"
CASES = {
    "nothing": (lambda path, scene: None, GIVEN, "write the file that it is given"),
    "a folder": (lambda path, scene: path.mkdir(), GIVEN, "its suffix has a dot"),
    "another error": (lambda path, scene: 1 / 0, GIVEN, "ZeroDivisionError"),
    "a file more": (beside, GIVEN, "leaves scene.log beside"),
    "chance": (by_chance, SAME, "other bytes the second time (scene.txt)"),
    "a refusal": (only_plain_colours, DEGREE, "refused what it must handle: harmonics"),
    "a need that it hides": (of_the_cameras, NEEDS, "raised AttributeError"),
    "writing into its input": (in_place, INPUTS, "work on a copy"),
}


@pytest.mark.parametrize("case", CASES)
def test_the_contract_names_what_is_wrong(case, complaint):
    write, claim, told = CASES[case]
    said = complaint(WriterContract, lambda: Spoiled(write), claim)
    assert told in said


def test_a_folder_must_be_made_and_filled(complaint):
    def build():
        return Spoiled(lambda path, scene: path.mkdir(), suffix="-tiles")

    assert "make the folder" in complaint(WriterContract, build, GIVEN)


def test_a_writer_may_need_all_that_a_scene_may_have():
    names = [*SceneToWrite.__dataclass_fields__][1:]

    class Bound(WriterContract):
        def build(self):
            return Spoiled(plainly, needs=tuple(names))

    Bound().test_needs_what_it_says_and_no_more()
    least = SceneToWrite(Bound().scene_to_write().gaussians)
    told = "spoiled needs cameras and names and"
    with pytest.raises(ContractViolation, match=told), Bound().written(least):
        pass
