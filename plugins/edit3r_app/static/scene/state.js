// What the parts of a scene's page share: where it stands, and what the server said last.
import { toast } from "../dom.js";

// Of the scene that was open last: the drawer and the chosen thing stay as they are with its next state.
let kept = { scene: null };

// The parts add themselves: picture, viewer, stage, strip, draft, question, adjust, sculpt, verdicts, bar, tools, waiting, things, drawers, keys.
export function newPage(scene, at, beside) {
  if (kept.scene !== scene) kept = { scene, drawer: "", chosen: "", hidden: new Set(), keys: [], compares: true, photo: 0 };
  const stop = new AbortController();
  const page = {
    scene,
    at,
    beside,
    kept,
    stop, // aborted when another page is shown
    on: { signal: stop.signal }, // of listeners that end with this page
    s: null, // what the server said of the scene last
    look: null, // what the draft means
    // which photo is shown, in all states of the scene
    get photo() {
      return kept.photo;
    },
    set photo(index) {
      kept.photo = index;
    },
    typed: 0, // when somebody typed last [ms]; 0: what came of it is shown
    view: "photo", // or "3d"
    tool: "point",
    minus: false, // marks take away
    brush: 0.02, // its radius, of the longer side of the photo or of the scene's window
    exact: false, // boxes are taken as they are drawn
    state: () => at || scene,
    current: () => page.s.photos[page.photo],
    gone: () => stop.signal.aborted,
    attempt,
  };
  return page;
}

// What `work` returns; null where the server refused, which is said, or where it was aborted.
async function attempt(work) {
  try {
    return await work();
  } catch (error) {
    if (error.name !== "AbortError") toast(error.message, true);
    return null;
  }
}
