"""What the page shows of a scene, and what it may ask for: plain data in, plain data out."""

import threading
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from pydantic import ValidationError

from edit3r.contract.errors import InputError
from edit3r.kit.files.atomic import atomic_write
from edit3r.running import MAX_PROMPT, SceneInput
from edit3r_app import uploads
from edit3r_app.downloads import VIEWER, has_edits, offered_files
from edit3r_app.draft import MARK, STEP, Draft, read_draft, write_draft
from edit3r_app.drawing import Drawing
from edit3r_app.forms import run_settings, set_by_hand, settings_form
from edit3r_app.jobs import (
    PREVIEW,
    AppJob,
    JobsFolder,
    manifest_of,
    objects_of,
    tree,
)
from edit3r_app.made_scenes import open_made
from edit3r_app.objects import DRAWN, MARKED, read_action
from edit3r_app.preview_service import DraftAnswer, PreviewService
from edit3r_app.progress import read_progress, time_left
from edit3r_app.runner import Runner
from edit3r_app.sessions import PhotosProgress
from edit3r_app.wording import in_app

SAY = "Say what to change first, such as: paint it golden."
MAX_SCENES = 200  # on the first page
LEFT = "left"  # file beside a scene: the name of its state that was looked at last
_CHANGING = threading.Lock()
"""A draft is read, changed and written under this lock: several requests come at once."""


@dataclass(frozen=True)
class Studio:
    """The parts of the app that pages ask."""

    folder: JobsFolder
    runner: Runner
    previews: PreviewService
    drawing: Drawing

    def renew(self) -> None:
        """Answer anew from now on: other weights are on this machine."""
        self.previews.renew()
        self.runner.renew()

    def prepare(self) -> None:
        """Load what somebody who sees the first page will need next."""
        self.previews.prepare()
        self.runner.make_ready()

    # ---- what there is ----

    def scenes(self) -> list[dict[str, Any]]:
        """Every scene with its first photo; one that cannot be read does not hide the others."""
        histories: dict[str, list[AppJob]] = {}
        for job in self.folder.jobs():
            histories.setdefault(job.scene, []).append(job)
        found = []
        for name in self.folder.scenes()[:MAX_SCENES]:
            photos = list(self.folder.photos(name))
            history = histories.get(name, [])
            at = self._left_at(name, history)
            counts = {"count": len(photos), "edits": len(history)}
            shown = {"photos": photos[:1], "at": at, "shown": self._rendered(at)}
            found.append({"name": name, **counts, **shown})
        return found

    def _rendered(self, name: str) -> list[str]:
        """The first picture of a run's scene, where there is one."""
        is_run = bool(name) and self.folder.is_run(name)
        return list(self.folder.images(name, "renders"))[:1] if is_run else []

    def _left_at(self, scene: str, history: list[AppJob]) -> str:
        """The state of a scene that was looked at last; "" for its photos."""
        note = self.folder.private / scene / LEFT
        if not note.is_file():  # nobody looked: the newest that worked
            done = [one.name for one in history if one.state == "done"]
            return next((one for one in reversed(done) if one != scene), "")
        name = note.read_text(encoding="utf-8")
        return name if name in [one.name for one in history] else ""

    def _leave_at(self, scene: str, state: str, history: list[AppJob]) -> None:
        at = "" if state == scene else state
        if at != self._left_at(scene, history):
            with atomic_write(self.folder.beside(scene) / LEFT) as partial:
                partial.write_text(at, encoding="utf-8")

    def made(self, name: str) -> dict[str, Any]:
        """A scene to try; see `open_made`."""
        return open_made(self.folder, name, self.previews.size)

    def scene(self, scene: str, at: str) -> dict[str, Any]:
        """All that the page of a scene shows at one of its states."""
        folder, state = self.folder, self._state(scene, at)
        is_run = folder.is_run(state)
        waits = state != scene and not is_run
        draft = read_draft(folder, state)
        photos = list(folder.photos(scene if waits else state))
        # An object's edit leaves no photos that show its scene.
        by_hand = is_run and not photos
        if by_hand:
            photos = list(folder.images(state, "renders"))
        history = folder.history(scene)
        at_rest = waits or by_hand
        is_splat = not waits and folder.splat(state) is not None
        self._leave_at(scene, state, history)
        reading = (
            PhotosProgress(by_hand, by_hand) if at_rest else self.previews.begin(state)
        )
        if is_run and reading.photos:  # nothing else is waited for
            self.runner.make_ready()
        return {
            "scene": scene,
            "state": state,
            "isRun": is_run,
            "byHand": by_hand,
            "isSplat": is_splat,
            "objects": objects_of(folder, state),
            "photos": photos,
            "fixed": bool(history) or is_splat or folder.is_run(scene),
            "fromRun": folder.is_run(scene),
            "history": [self._told(job, depth) for depth, job in tree(history)],
            "job": self._work(state) if waits else None,
            "preview": list(folder.images(state, PREVIEW)) if waits else [],
            "reading": {**asdict(reading), "trouble": in_app(reading.trouble)},
            "draft": self._drawn(draft, state),
        }

    def _state(self, scene: str, at: str) -> str:
        self.folder.path(scene)
        if at and at != scene and self.folder.job(at).scene != scene:
            raise InputError(f"{at}: not an edit of {scene}.")
        return at or scene

    def _told(self, job: AppJob, depth: int) -> dict[str, Any]:
        """One edit of the history."""
        shown = self._rendered(job.name)
        return {
            "name": job.name,
            "parent": job.parent,
            "depth": depth,
            "prompt": job.prompt,
            "state": job.state,
            "sentence": in_app(job.sentence),
            "photo": shown[0] if shown else "",
            "set": set_by_hand(job.settings),
            # of an object's edit there is none: those of the run before are kept with it
            "verdicts": [] if job.object else list(verdicts(self.folder, job.name)),
        }

    def _work(self, name: str) -> dict[str, Any]:
        """How far an edit is that waits, is being made, or failed."""
        job = self.folder.job(name)
        progress = read_progress(self.folder.log(name))
        timed = job.state == "running" and not job.object
        left = time_left(self.folder, job, progress) if timed else None
        return {
            "state": job.state,
            "prompt": job.prompt,
            "parent": job.parent,
            "sentence": in_app(job.sentence),
            "active": job.is_active,
            "stage": progress.stage,
            "share": progress.whole or None,
            "left": left,
            "done": [
                {"name": stage, "seconds": round(seconds, 1)}
                for stage, seconds in progress.done.items()
            ],
            "told": [in_app(text) for text in progress.told],
            "trouble": self.runner.trouble,
            "kept": has_edits(self.folder, name),
        }

    # ---- marks, words, settings ----

    def _drawn(self, draft: Draft, state: str) -> dict[str, Any]:
        """A draft as the page draws it, and the version that images are asked for by."""
        located = self.previews.sessions.is_located(state)
        version = zlib.crc32(f"{draft.as_json()}{located}".encode())
        return {
            **asdict(draft),
            "outline": draft.outline,
            "selects": draft.selects,
            "version": version,
            "named": sorted(read_draft(self.folder, self._home(state)).named),
        }

    def change(self, state: str, asked: dict[str, Any]) -> dict[str, Any]:
        """Change the draft of a state: `do` says how; returns it as the page draws it.

        Raises InputError for what is no change.
        """
        return self._drawn(self._changed(state, asked), state)

    def _changed(self, state: str, asked: dict[str, Any]) -> Draft:
        """The draft of a state, changed as `asked`; another tab may change it again at once."""
        self._is_state(state)
        do, home = str(asked.get("do")), self._home(state)
        with _CHANGING:
            draft, kept = (read_draft(self.folder, one) for one in (state, home))
            draft.named = kept.named
            _change(draft, do, asked.get("value"))
            if do in _NAMING:
                write_draft(self.folder, home, replace(kept, named=draft.named))
            write_draft(self.folder, state, draft)
        return draft

    def _home(self, state: str) -> str:
        """The set of photos of a state, where its named selections are."""
        return self.folder.job(state).scene if self.folder.is_run(state) else state

    def step(self, state: str, value: int) -> dict[str, Any]:
        """Take the next larger or smaller candidate; one that shows nothing new is taken back."""
        before = read_draft(self.folder, state)
        drawn = self.change(state, {"do": "step", "value": ["larger", value]})
        after = read_draft(self.folder, state)
        if self.previews.changes(state, before, after):
            return drawn
        if read_draft(self.folder, state) == after:  # meanwhile nothing else was said
            write_draft(self.folder, state, before)
        word = "larger" if value > 0 else "smaller"
        raise InputError(f"there is no {word} candidate of what is selected.")

    def look(self, state: str) -> dict[str, Any]:
        """What the draft means: how the sentence is read, and what is selected."""
        self._is_state(state)
        draft = read_draft(self.folder, state)
        if draft.selects or draft.form.get("prompt"):
            self.runner.make_ready()
        look = self.previews.look(
            state, draft, lambda: read_draft(self.folder, state) == draft
        )
        return {
            "version": self._drawn(draft, state)["version"],
            "understood": look.understood,
            "problem": in_app(look.problem),
            "asks": look.asks,
            "told": [in_app(text) for text in look.messages],
            "confidence": look.confidence,
            "sure": look.is_sure,
            "selected": look.masks is not None,
            "runs": look.job is not None,
            "candidates": [one.number for one in look.candidates],
        }

    def suggestions(self, state: str, name: str) -> list[dict[str, Any]]:
        """The marks that take what may be meant on a photo; pictures are asked for by number."""
        self._is_state(state)
        return [asdict(mark) for mark, _ in self.previews.suggestions(state, name)]

    def verdict(self, state: str) -> dict[str, str] | None:
        """What the 2D edit of a quick editor is worth; None of others."""
        self._is_state(state)
        draft = read_draft(self.folder, state)
        judged = self.previews.edit_verdict(self.previews.look(state, draft))
        if judged is None:
            return None
        return {"label": judged.label, "reason": in_app(judged.reason)}

    def settings(self, state: str) -> list[dict[str, Any]]:
        """The settings of a state's draft as groups of fields."""
        self._is_state(state)
        return settings_form(read_draft(self.folder, state), self.previews.registry)

    # ---- edits ----

    def go(self, scene: str, at: str, sentence: str) -> str:
        """Put the edit that a draft asks for into the queue; returns its name."""
        state = self._state(scene, at)
        draft = self._changed(state, {"do": "say", "value": sentence})
        look = self.previews.look(state, draft)
        if look.job is None:
            raise InputError(look.problem or SAY)
        job = AppJob(
            name="",
            scene=scene,
            parent=state if self.folder.is_run(state) else "",
            settings=run_settings(draft, self.previews.registry),
            size=self.previews.size,
        )
        return self._queued(job, look)

    def act(self, scene: str, at: str, asked: dict[str, Any]) -> str:
        """Put an action on an object into the queue; returns the name of its run."""
        state, action = self._state(scene, at), read_action(asked)
        if not self.folder.is_run(state):
            raise InputError("there is no scene yet: make an edit first, then take it.")
        masks = drawn = None
        is_marked = action.action == MARKED
        if action.action in DRAWN or (is_marked and self.drawing.is_drawn(state)):
            drawn = self.drawing.file(state)
        elif is_marked:
            masks = self.previews.look(state, read_draft(self.folder, state)).marked
            if masks is None:
                raise InputError("point at the thing first, then give it a name.")
        job = AppJob(
            name="",
            scene=scene,
            parent=state,
            settings={"prompt": action.in_words},
            object=action,
        )
        marked = () if masks is None else masks
        return self.folder.new_job(job, marked, drawn=drawn).name

    def draw(self, run: str, asked: dict[str, Any]) -> dict[str, Any]:
        """Change what is drawn over a scene; returns what it chooses."""
        given = self.previews.sessions.scene_of(run)
        if given is not None and asked.get("do") == "stroke":
            asked = {**asked, "value": _in_own_frame(asked.get("value"), given)}
        return self.drawing.change(run, asked)

    def _queued(self, job: AppJob, look: DraftAnswer) -> str:
        known = None if job.parent else self.previews.sessions.keep(job.scene)
        masks = () if look.marked is None else look.marked
        job = self.folder.new_job(job, masks, known)
        self.previews.begin_preview(look, job.name)
        return job.name

    def turn_upright(self, scene: str, up: str) -> None:
        """Show a dropped scene with another axis of it upwards; its marks are forgotten."""
        uploads.turn_upright(self.folder, scene, up)
        write_draft(self.folder, scene, Draft())
        (self.folder.beside(scene) / VIEWER).unlink(missing_ok=True)
        self.previews.sessions.forget(scene)

    def take_out(self, scene: str, photo: str) -> None:
        uploads.remove(self.folder, scene, photo)

    def delete(self, scene: str) -> None:
        """Take a scene away with its edits; they stay in a folder of their own."""
        if scene not in self.folder.scenes():
            raise InputError(f"{scene[:60]!r}: no scene of that name.")
        states = [scene, *(job.name for job in self.folder.history(scene))]
        self.folder.delete(scene)
        for state in states:
            self.previews.sessions.forget(state)

    def files(self, run: str) -> list[dict[str, Any]]:
        """What there is to download of a run."""
        return offered_files(self.folder, run)

    def _is_state(self, state: str) -> None:
        self.folder.path(state)


def _in_own_frame(stroke: Any, given: SceneInput) -> Any:
    """A stroke whose camera is in the frame of view 0, in the frame of the scene's file."""
    c2w, unit = given.views.c2w.double(), given.views.unit
    with suppress(TypeError, KeyError, ValueError, RuntimeError):
        moved = {
            axis: (c2w[:3, :3] @ torch.tensor(stroke[axis]).double()).tolist()
            for axis in ("right", "down", "forward")
        }
        centre = c2w[:3, :3] @ torch.tensor(stroke["centre"]).double() * unit
        return {**stroke, **moved, "centre": (centre + c2w[:3, 3]).tolist()}
    return stroke  # what is none is refused where strokes are read


def _change(draft: Draft, do: str, value: Any) -> None:
    """Change a draft as the page asked; raises InputError for anything else."""
    try:
        if do == "mark":
            draft.take(MARK.validate_python(value))
        elif do == "step":
            kind, by = value
            draft.take(STEP.validate_python({"kind": kind, "value": by}))
        elif do == "undo":
            draft.take_back()
        elif do == "redo":
            draft.take_again()
        elif do in _WAYS:
            _WAYS[do](draft, value)
        else:
            raise InputError(f"{do[:40]!r}: no such change of a draft.")
    except (ValidationError, TypeError, ValueError, KeyError):
        raise InputError(f"{do[:40]!r}: not a change that can be made.") from None


def _select(draft: Draft, words: Any) -> None:
    """Begin anew, with nothing or with words that name the thing."""
    draft.marks, draft.undone = [], []
    draft.words = str(words or "")[:200]


def _say(draft: Draft, sentence: Any) -> None:
    draft.form["prompt"] = str(sentence)[: MAX_PROMPT + 1]


def _set(draft: Draft, asked: Any) -> None:
    """One setting: its group ("" for what is chosen), its name, and what was typed."""
    group, name, text = map(str, asked)
    if not group:
        draft.form[name] = text
        return
    draft.form.setdefault("settings", {}).setdefault(group, {})[name] = text


def _keep(draft: Draft, name: Any) -> None:
    if not draft.marks or not str(name).strip():
        raise InputError("point at something first, then give it a name to keep.")
    draft.named[str(name)[:60]] = list(draft.marks)


def _recall(draft: Draft, name: Any) -> None:
    draft.marks, draft.undone, draft.words = list(draft.named[name]), [], ""


def _drop(draft: Draft, name: Any) -> None:
    del draft.named[name]


_NAMING = ("keep", "drop")  # change what is kept by name
_WAYS = {
    "select": _select,
    "say": _say,
    "set": _set,
    "keep": _keep,
    "recall": _recall,
    "drop": _drop,
}


ANSWERS = {"selected": "selection_verdict", "edit": "edit_verdict", "scene": "verdict"}
"""How a run's three answers are called, and where its run.json has them."""


def verdicts(folder: JobsFolder, run: str) -> Iterator[dict[str, str]]:
    """A run's three answers; of one that is not finished those on its preview."""
    beside = folder.private / run / PREVIEW
    manifest = manifest_of(folder.root / run) or manifest_of(beside)
    for on, key in ANSWERS.items():
        verdict = manifest.get(key)
        if isinstance(verdict, dict):
            label, reason = str(verdict.get("label")), str(verdict.get("reason", ""))
            yield {"on": on, "label": label[:40], "reason": in_app(reason[:1000])}
