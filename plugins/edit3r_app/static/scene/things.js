// What is done with a thing of the scene: a state of its own, so that it can be undone.
import { go, sceneAddress } from "../address.js";
import { ask, tell } from "../api.js";
import { toast } from "../dom.js";

// What is being done, and what then was done.
const ACTIONS = {
  add: ["taking hold of it", "is a thing of the scene now"],
  remove: ["removing it", "is removed"],
  recolor: ["painting it", "is painted"],
  rename: ["another name", "has another name"],
  move: ["moving it", "is moved"],
  turn: ["turning it", "is turned"],
  scale: ["resizing it", "is resized"],
  copy: ["copying it", "is copied"],
  cut: ["Removing what is drawn", "What was drawn is removed."],
  crop: ["Removing all else", "All else is removed."],
  clean: ["Looking for floaters", "Floaters are taken out."],
  measure: ["Bringing all lengths into metres", "All lengths are in metres."],
  find: ["Looking for things", "The things that were found are in the list."],
};

export function thingsOf(page) {
  const { scene, at, kept } = page;
  let shaping = false;
  async function shape(action, name, { numbers = [], text = "" } = {}) {
    if (shaping) return;
    shaping = true;
    if (kept.drawer) page.drawers.draw();
    const [doing, done] = ACTIONS[action] || [action, ""];
    page.waiting.long(name ? `${name}: ${doing}` : doing);
    const asked = { at, action, name, numbers, text };
    const job = await page.attempt(async () => {
      const made = await tell(["object", scene], asked);
      await finished(made);
      return made;
    });
    shaping = false;
    page.waiting.long("");
    if (page.gone()) return;
    if (!job) {
      if (name) page.viewer.again(); // a thing that was taken hold of goes back
      if (kept.drawer) page.drawers.draw();
      return;
    }
    page.draft.endRedo();
    if (action === "copy" || action === "rename") kept.chosen = text;
    if (action === "add") kept.chosen = name;
    go(sceneAddress(scene, job));
    toast(name ? `${name} ${done}. Undo takes it back.` : `${done} Undo takes it back.`);
  }
  async function finished(job) {
    while (!page.gone()) {
      const found = await ask("scene", scene, { at: job });
      if (found.isRun) return;
      const is = found.job.state; // done: it ended while the server answered
      if (!found.job.active && is !== "done") throw new Error(found.job.sentence);
      await new Promise((done) => setTimeout(done, 300));
    }
  }
  return { shape, isBusy: () => shaping };
}
