"""The critic `limits`: figures of edit and scene, held to limits that were chosen on known ones."""

from dataclasses import replace

from edit3r.contract.interfaces import Critic, EditToJudge, SceneToJudge
from edit3r.contract.verdicts import EditVerdict, Verdict
from edit3r_judge.between import guessed_between
from edit3r_judge.edit_measures import measure_edit, measure_edit_in_3d
from edit3r_judge.edit_verdict import EditMeasures, judge_edit
from edit3r_judge.verdict import Doubt, judge

FLAT = (
    "all that the photos share lies on one plane: a flat thing, or photos from one place. Take a "
    "step to the side between photos, or tell the lens (--fov)"
)
UNSURE_LENS = (
    "the lens is not sure: fields of view from {:.0f} to {:.0f} degrees explain the photos alike. "
    "Give --fov if you know it, or more photos from other sides"
)
MOVED = (
    "the 2D edits had moved against their photos and were moved back, which cannot bring back what "
    "left the picture. Let the editor leave everything where it is"
)


class LimitsCritic(Critic):
    """See docs/verdict.md."""

    def judge_edit(self, edit: EditToJudge) -> EditVerdict:
        if edit.in_2d is not None and edit.rendered is not None:
            measures = EditMeasures(**edit.in_2d.measures)
            measures = measure_edit_in_3d(measures, edit)
            return judge_edit(measures, edit.in_2d.confidence)
        measures = measure_edit(edit)
        faults = (*edit.faults, *measures.faults)
        measures = replace(measures, faults=faults, moved=edit.moved)
        return judge_edit(measures, confidence_of(edit))

    def judge_scene(self, scene: SceneToJudge) -> Verdict:
        guessed = None
        if scene.geometry is not None:
            used = [view for view, there in enumerate(scene.placed) if there]
            guessed = guessed_between(scene.geometry, scene.photos)[:, used]
        return judge(
            scene.edited,
            scene.first,
            scene.rendered,
            scene.placed,
            scene.measured,
            doubt_of(scene),
            scene.transient,
            guessed,
        )


def confidence_of(edit: EditToJudge) -> float | None:
    """How surely the least sure thing was found, None where everything was marked; 0: a guess."""
    confidences = [
        one.confidence for one in edit.selected if one.confidence is not None
    ]
    if any("guess" in one.how for one in edit.selected):
        confidences.append(0.0)
    return min(confidences, default=None)


def doubt_of(scene: SceneToJudge) -> Doubt | None:
    """What else speaks against the scene: its edits, or photos that tell no depth or no lens."""
    measures = {} if scene.edit is None else scene.edit.measures
    if measures.get("faults"):
        return Doubt("the 2D edits do not show what their photos show (see the edit)")
    if scene.flat:
        return Doubt(FLAT)
    if scene.lenses is not None:
        return Doubt(UNSURE_LENS.format(*scene.lenses))
    if measures.get("moved"):
        return Doubt(MOVED, best="good")
    return None
