// What is done with a thing of the scene: a state of its own, so that it can be undone.
import { go, sceneAddress } from "../app.js";
import { ask, tell } from "../api.js";

const ACTIONS = {
  add: "taking hold of it",
  remove: "removing it",
  recolor: "painting it",
  rename: "another name",
  move: "moving it",
  turn: "turning it",
  scale: "resizing it",
  copy: "copying it",
};

export function thingsOf(page) {
  const { scene, at, kept } = page;
  let shaping = false;
  async function shape(action, name, { numbers = [], text = "" } = {}) {
    if (shaping) return;
    shaping = true;
    if (kept.drawer) page.drawers.draw();
    page.waiting.long(
      action === "find" ? "Looking for things" : `${name}: ${ACTIONS[action] || action}`,
    );
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
      page.viewer.again();
      if (kept.drawer) page.drawers.draw();
      return;
    }
    page.draft.endRedo();
    if (action === "copy" || action === "rename") kept.chosen = text;
    if (action === "add") kept.chosen = name;
    go(sceneAddress(scene, job));
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
