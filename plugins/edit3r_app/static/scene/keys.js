// Keys, and the wheel over a photo.
import { showKeys } from "../panels.js";
import { fullScreen, has3d } from "./stage.js";

export function keysOf(page, stage, toggleStrip) {
  const flip = (what) => () => {
    page[what] = !page[what];
    page.tools.draw();
  };
  const acts = {
    p: () => page.tools.take("point"),
    b: () => page.tools.take("box"),
    r: () => page.tools.take("brush"),
    l: () => page.tools.take("lasso"),
    "[": () => page.tools.wider(0.75),
    "]": () => page.tools.wider(4 / 3),
    n: () => page.draft.openNames(),
    x: flip("minus"),
    e: flip("exact"),
    "+": () => page.draft.larger(1),
    "=": () => page.draft.larger(1),
    "-": () => page.draft.larger(-1),
    i: () => page.draft.change("step", ["invert", 0]),
    w: () => page.look && page.look.candidates.length > 1 && page.question.showOthers(),
    c: () => page.verdicts.toggle(),
    k: () => page.ruler.toggle(),
    escape: back,
    h: () => page.drawers.toggle("history"),
    o: () => page.s.isRun && page.drawers.toggle("objects"),
    d: () => page.drawers.openFiles(),
    s: () => page.drawers.openSettings(),
    v: toggleStrip,
    f: fullScreen,
    "?": () => showKeys(),
    "/": () => page.bar.focus(),
    m: () => {
      if (!has3d(page.s) || page.s.byHand) return;
      page.view = page.view === "3d" ? "photo" : "3d";
      page.stage.draw();
    },
  };
  // Whether the key is one of ours.
  function press(key) {
    if (acts[key]) acts[key]();
    else if (Number(key) && page.s.photos[key - 1]) page.strip.show(key - 1);
    else return false;
    return true;
  }
  function back() {
    if (page.kept.drawer) page.drawers.toggle(page.kept.drawer, false);
    else if (document.body.classList.contains("only-scene")) fullScreen();
    page.verdicts.close();
    page.question.close();
    page.ruler.close();
  }
  addEventListener(
    "keydown",
    (event) => {
      if (!page.s || document.querySelector("dialog[open]")) return;
      if (event.key === "Escape") return press("escape");
      const typed = event.target.closest("input, textarea, select"),
        key = event.key.toLowerCase();
      if (typed) return;
      if (event.ctrlKey || event.metaKey) {
        if (key !== "z" && key !== "y") return;
        event.preventDefault();
        const again = key === "y" || event.shiftKey;
        return void (again ? page.draft.redo() : page.draft.undo());
      }
      if (!event.altKey && press(key)) event.preventDefault();
    },
    page.on,
  );
  let turned = 0;
  stage.addEventListener(
    "wheel",
    (event) => {
      // larger and smaller candidates of what is selected
      if (document.body.dataset.view !== "photo" || event.ctrlKey) return;
      event.preventDefault();
      if (performance.now() - turned < 400 || !page.s.draft.selects) return;
      turned = performance.now();
      page.draft.larger(event.deltaY < 0 ? 1 : -1);
    },
    { passive: false, ...page.on },
  );
  return { press };
}
