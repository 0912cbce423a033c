"""The critic `limits`: figures of edit and scene, held to limits that were fitted to known ones."""

from collections.abc import Mapping

from edit3r.contract.interfaces import Critic, EditToJudge, SceneToJudge
from edit3r.contract.verdicts import EditVerdict, Verdict
from edit3r_judge.between import guessed_between
from edit3r_judge.blame import Doubt
from edit3r_judge.signals import faults_of, fitted_limits, measured
from edit3r_judge.verdict import judge

FLAT = (
    "all that the photos share lies on one plane: a flat thing, or photos from one place. Take a "
    "step to the side between photos, or tell the lens (--fov)"
)
UNSURE_LENS = (
    "the lens is not sure: fields of view from {:.0f} to {:.0f} degrees explain the photos "
    "equally well. Give --fov if you know it, or more photos from other sides"
)
MOVED = (
    "the 2D edits had moved against their photos and were moved back, which cannot bring back what "
    "left the picture. Let the editor leave everything where it is"
)


LEAST = 1.5 / 255  # difference of colours [sRGB] that a picture of 8 bits can hold


class LimitsCritic(Critic):
    """See docs/verdict.md."""

    def judge_edit(self, edit: EditToJudge) -> EditVerdict:
        figures = measured(edit)
        faults = (*edit.faults, *faults_of(figures, fitted_limits("edit")).values())
        faults = faults or silence(edit, figures)
        measures = {**figures, "faults": list(edit.faults), "moved": list(edit.moved)}
        if faults:
            return EditVerdict("doubtful", "; ".join(faults), measures)
        told = figures["as_asked"] is not None or figures["closed"] is not None
        return EditVerdict("good", _praise(edit, told), measures)

    def judge_scene(self, scene: SceneToJudge) -> Verdict:
        guessed = None
        if scene.geometry is not None:
            used = [view for view, there in enumerate(scene.placed) if there]
            guessed = guessed_between(scene.geometry, scene.photos)[:, used]
        return judge(scene, guessed, doubt_of(scene))


def silence(edit: EditToJudge, figures: Mapping[str, float | None]) -> tuple[str, ...]:
    """What is said where no signal tells anything; () where one does, or the picture changed."""
    views = list(edit.edited)
    masks = None if edit.masks is None else edit.masks[0, views]
    if masks is not None and not bool((masks > 0.5).any()):
        return ("nothing is selected on any photo, so nothing was to change",)
    before, after = edit.before.images[0, views], edit.after.images[0, views]
    if float((after - before).abs().amax()) < LEAST:
        return ("nothing changed",)
    if masks is not None and all(one is None for one in figures.values()):
        share = float((masks > 0.5).float().mean())
        return (
            f"what is selected is too small to tell ({share:.2%} of the photos): look at it",
        )
    return ()


def _praise(edit: EditToJudge, told: bool) -> str:
    """What was measured of an edit that nothing speaks against; not that it was what was meant."""
    where = "the whole picture" if edit.masks is None else "what was selected"
    shown = "" if edit.rendered is None else ", in 3D too"
    if told and {one.action for one in edit.instructions} == {"remove"}:
        return f"it is gone{shown}; look at what stands in its place, which no signal can judge"
    if not told:
        return f"{where} changed{shown}; whether as asked, no signal tells"
    return f"carried out as asked on {where}{shown}"


def doubt_of(scene: SceneToJudge) -> Doubt | None:
    """What else speaks against the scene: its edits, or photos that tell no depth or no lens."""
    measures = {} if scene.edit is None else scene.edit.measures
    if measures.get("faults"):
        clause = "the 2D edits do not show what their photos show (see the edit)"
        return Doubt(clause, "editor")
    if scene.flat:
        return Doubt(FLAT, "photos")
    if scene.fov_range is not None:
        return Doubt(UNSURE_LENS.format(*scene.fov_range), "photos")
    if measures.get("moved"):
        return Doubt(MOVED, "editor", best="good")
    return None
