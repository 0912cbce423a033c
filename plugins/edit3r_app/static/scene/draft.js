// The draft of an edit: changed on the server, then answered with what it means; undo and redo.
import { go, sceneAddress } from "../address.js";
import { ask, path, tell } from "../api.js";
import { toast } from "../dom.js";
import { showNames } from "../panels.js";
import { imageThere } from "./picture.js";

const PATIENCE = 2000; // [ms] of looking for words before pointing is offered
const undone = new Map(); // of each scene: the states that undo went back from, the last one last

export function draftOf(page) {
  const { scene } = page;
  async function change(kind, value) {
    if (kind === "say") soonPoint(value);
    const draft = await page.attempt(() => tell(["draft", page.state()], { do: kind, value }));
    if (!draft) return soonPoint("");
    took(draft);
    await answer();
  }
  async function larger(way) {
    if (!page.s.draft.selects && !(page.look && page.look.selected))
      return toast("Nothing is selected yet: point at something first.", true);
    page.waiting.busy(way > 0 ? "Looking for something larger" : "Looking for something smaller");
    const draft = await page.attempt(() => tell(["step", page.state()], { value: way }));
    page.waiting.busy("");
    if (draft) {
      took(draft);
      await answer();
    }
  }
  function took(draft) {
    page.s.draft = draft;
    page.picture.drawMarks();
    page.tools.draw();
    page.bar.drawChip();
    page.drawers.followMarks();
  }

  let asking = 0,
    asked = null,
    late = 0,
    searched = "", // the words that it waits for
    adjusting = 0,
    words = new AbortController(); // of what is asked about the present sentence
  // Nobody waits any more for what was asked about the words before.
  function newWords() {
    words.abort();
    words = new AbortController();
  }
  // How much of the edit is taken: the photo shows it at once, what is said of it follows.
  async function adjust(name, value) {
    const draft = await page.attempt(() =>
      tell(["draft", page.state()], { do: "set", value: ["run", name, String(value)] }),
    );
    if (!draft) return;
    page.s.draft = draft;
    page.picture.preview(true);
    clearTimeout(adjusting);
    adjusting = setTimeout(answer, 1000);
  }
  // Words that are not answered in time lead to pointing, however long the server takes.
  function soonPoint(words) {
    const wait = !page.s.draft.selects && !page.s.byHand && words ? words.trim() : "";
    if (wait && wait === searched) return;
    clearTimeout(late);
    searched = wait;
    if (wait) late = setTimeout(() => page.question.point("Still looking for it."), PATIENCE);
  }
  async function answer() {
    // what the draft means, on every photo
    const number = ++asking,
      { draft } = page.s;
    page.waiting.busy(draft.selects || draft.form.prompt ? "Finding it on every photo" : "");
    page.picture.preview();
    soonPoint(draft.form.prompt);
    // One question at a time: of those that wait the last is asked. A sentence alone is read at once.
    while (asked && draft.selects) await asked;
    if (number !== asking || page.gone()) return;
    const version = page.s.draft.version,
      place = page.state();
    const { signal } = words;
    const mine = (asked = page.attempt(() => ask("look", place, { v: version, signal })));
    const found = await mine;
    if (asked === mine) asked = null;
    if (number !== asking) return;
    soonPoint("");
    page.waiting.busy("");
    if (!found || page.gone()) return;
    page.look = found;
    page.bar.drawUnderstood();
    page.bar.drawChip();
    page.question.draw();
    page.tools.draw();
    page.verdicts.draw();
    page.picture.preview(true);
    for (const name of page.s.photos) {
      const address = `${path("overlay", place, name)}?v=${found.version}`;
      imageThere(address).then((there) => {
        if (there && number === asking) page.picture.setOver(name, address);
      });
    }
    if (!found.runs) return;
    const judged = await ask("verdict", place, { v: version, signal }).catch(() => null);
    if (number === asking && judged) {
      page.look.judged = judged;
      page.bar.drawUnderstood();
    }
  }

  // ---- undo and redo: of marks, and where there are none of edits ----
  const marked = () => Boolean(page.s.draft.marks.length || page.s.draft.words);
  const canUndo = () => page.sculpt.has() || marked() || (page.s.isRun && !(page.s.fromRun && page.state() === scene));
  const canRedo = () => Boolean(page.s.draft.undone.length || undone.get(scene)?.length);
  function undo() {
    if (page.sculpt.has()) return page.sculpt.back();
    if (marked() || !canUndo()) return change("undo"); // the server may know of a mark that is on its way
    const one = page.s.history.find(({ name }) => name === page.state());
    undone.set(scene, [...(undone.get(scene) || []), page.state()]);
    go(sceneAddress(scene, (one && one.parent) || ""));
  }
  function redo() {
    const states = undone.get(scene);
    if (page.s.draft.undone.length || !states?.length) return change("redo");
    go(sceneAddress(scene, states.pop()));
  }

  const openNames = () =>
    !page.s.draft.marks.length && !page.s.draft.named.length
      ? toast("Mark something first; then it can be kept by a name.", true)
      : showNames(page.s.draft.named, page.s.draft.marks.length > 0, async (kind, name) => {
          await change(kind, name);
          return page.s.draft.named;
        });
  return {
    change,
    larger,
    adjust,
    took,
    answer,
    undo,
    redo,
    canUndo,
    canRedo,
    newWords,
    endRedo: () => undone.delete(scene),
    leave: () => [late, adjusting].forEach(clearTimeout),
    openNames,
  };
}
