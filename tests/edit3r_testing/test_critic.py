"""The critic's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Critic
from edit3r_testing import CriticContract


class Spoiled(Critic):
    """A good critic with its verdicts changed by functions of them and of what is judged."""

    def __init__(self, good, edit=None, scene=None):
        self.good, self.changes = good, (edit, scene)

    def judge_edit(self, edit):
        return changed(self.good.judge_edit(edit), self.changes[0], edit)

    def judge_scene(self, scene):
        return changed(self.good.judge_scene(scene), self.changes[1], scene)


def changed(verdict, change, given):
    return change(verdict, given) if change else verdict


def saying(**fields):
    return lambda verdict, _: replace(verdict, **fields)


def write_into_edit(verdict, edit):
    edit.after.images.clamp_(0.2, 0.8)
    return verdict


def write_into_scene(verdict, scene):
    scene.rendered.images.clamp_(0.2, 0.8)
    return verdict


def needs_masks(verdict, edit):
    return replace(verdict, reason=str(edit.masks.shape))


def needs_3d(verdict, edit):
    return replace(verdict, reason=str(edit.rendered.images.shape))


def needs_geometry(verdict, scene):
    return replace(verdict, reason=str(scene.geometry.depths.shape))


def by_chance(verdict, _):
    return replace(verdict, reason=f"{float(torch.rand(()))}")


EDIT = "test_an_edit_is_judged_in_2d_and_again_in_3d"
FIGURES = "test_an_edit_is_judged_in_2d_and_again_in_3d"
NOTHING = "test_an_edit_that_changed_nothing_is_doubtful"
ENTRIES = "test_a_verdict_has_an_entry_for_each_photo"
WORSE = "test_a_scene_that_shows_other_pictures_is_worse"
TWICE, ALONE = "test_same_run_gives_the_same_verdict", "test_leaves_its_inputs_alone"
CASES = {
    "a word": ({"edit": lambda *_: "good"}, EDIT, "must return"),
    "a label of its own": ({"edit": saying(label="fine")}, EDIT, "label an edit good"),
    "no reason": ({"edit": saying(reason="")}, EDIT, "say why"),
    "masks always": ({"edit": needs_masks}, EDIT, "raised AttributeError"),
    "3D at once": ({"edit": needs_3d}, EDIT, "raised AttributeError"),
    "a list of figures": ({"edit": saying(measures=[1])}, FIGURES, "return dict"),
    "a tensor": (
        {"edit": saying(measures={"changed": torch.ones(())})},
        FIGURES,
        "that go into run.json",
    ),
    "not a number": (
        {"edit": saying(measures={"changed": float("nan")})},
        FIGURES,
        "that go into run.json",
    ),
    "praise for nothing": (
        {"edit": saying(label="good")},
        NOTHING,
        "call them doubtful",
    ),
    "a scene's label": ({"scene": saying(label="fine")}, ENTRIES, "label a scene good"),
    "geometry always": ({"scene": needs_geometry}, ENTRIES, "raised AttributeError"),
    "all placed": (
        {"scene": saying(placed=(True, True, True))},
        ENTRIES,
        "hand on `placed` of the scene",
    ),
    "the placed ones alone": (
        {"scene": saying(input_psnr=(30.0, 30.0))},
        ENTRIES,
        "for each of 3 photos",
    ),
    "0 for what is not known": (
        {"scene": saying(filled=(0.0, 0.0, 0.0))},
        ENTRIES,
        "None where nothing is known",
    ),
    "infinite": (
        {"scene": saying(agreement=(float("inf"), None, 30.0))},
        ENTRIES,
        "None where nothing is known",
    ),
    "percent": (
        {"scene": saying(coverage=(93.0, None, 97.0))},
        ENTRIES,
        "return coverage as a share",
    ),
    "praise for all": (
        {"scene": saying(label="good")},
        WORSE,
        "compare `rendered` with `edited`",
    ),
    "chance on edits": ({"edit": by_chance}, TWICE, "judged in two ways"),
    "chance on scenes": ({"scene": by_chance}, TWICE, "judged in two ways"),
    "writing into the edit": ({"edit": write_into_edit}, ALONE, "work on a copy"),
    "writing into the scene": ({"scene": write_into_scene}, ALONE, "work on a copy"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_critic_broken_by(case, examples, complaint):
    changes, claim, advice = CASES[case]
    good = examples.build("critic", "worked-critic")
    assert advice in complaint(CriticContract, lambda: Spoiled(good, **changes), claim)


def test_every_claim_about_critics_can_fail():
    own = {name for name in vars(CriticContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
