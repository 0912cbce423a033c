// The page of a scene: the scene, or before there is one the photo, fills it.
import { ROOT } from "./address.js";
import { ask } from "./api.js";
import { button, el, icon } from "./dom.js";
import { showKeys } from "./panels.js";
import { adjustOf } from "./scene/adjust.js";
import { barOf } from "./scene/bar.js";
import { draftOf } from "./scene/draft.js";
import { drawersOf } from "./scene/drawers.js";
import { keysOf } from "./scene/keys.js";
import { pictureOf } from "./scene/picture.js";
import { questionOf } from "./scene/question.js";
import { rulerOf } from "./scene/ruler.js";
import { fullScreen, stageOf } from "./scene/stage.js";
import { sculptOf } from "./scene/sculpt.js";
import { newPage } from "./scene/state.js";
import { stripOf } from "./scene/strip.js";
import { thingsOf } from "./scene/things.js";
import { toolsOf } from "./scene/tools.js";
import { verdictsOf } from "./scene/verdicts.js";
import { viewerOf } from "./scene/viewer.js";
import { waitingOf } from "./scene/waiting.js";

const POLLED = { soon: 500, later: 1500 }; // [ms]
const allScenes = (props, ...content) =>
  el("a", { href: ROOT, "data-ours": true, ...props }, ...content);

// Returns what is to be called when another page is shown.
export function scenePage(root, scene, at, beside) {
  document.title = `${scene} · edit3r`;
  document.body.className = "studio";
  const page = newPage(scene, at, beside);

  // ---- what stands where ----
  const stage = el("section", { class: "stage", "aria-label": "the scene" }),
    strip = el("nav", { class: "strip", "aria-label": "photos" }),
    views = el("div", { class: "switch", role: "group", "aria-label": "what is shown" });
  const files = button("download", "download", () => page.drawers.openFiles(), {
    key: "D",
    text: "Download",
    class: "icon named",
  });
  const stripButton = button("photos", "photos", toggleStrip, {
    key: "V",
    "aria-expanded": "true",
    class: "icon wide-only",
  });
  function toggleStrip() {
    const is = document.body.classList.toggle("no-strip");
    stripButton.setAttribute("aria-expanded", String(!is));
  }
  page.picture = pictureOf(page, stage);
  page.viewer = viewerOf(page, stage);
  page.strip = stripOf(page, strip);
  page.draft = draftOf(page);
  page.question = questionOf(page);
  page.bar = barOf(page);
  page.adjust = adjustOf(page);
  page.sculpt = sculptOf(page);
  page.ruler = rulerOf(page);
  page.verdicts = verdictsOf(page);
  page.tools = toolsOf(page);
  page.waiting = waitingOf(page);
  page.things = thingsOf(page);
  page.drawers = drawersOf(page);
  page.keys = keysOf(page, stage, toggleStrip);
  const { historyButton, objectsButton } = page.drawers;
  const dock = el("footer", { class: "dock unready" }, page.tools.node, page.bar.node);
  page.stage = stageOf(page, { stage, views, files, objects: objectsButton, dock });
  page.refresh = refresh;
  const top = el(
    "header",
    { class: "top unready" },
    allScenes({ class: "brand", title: "all scenes" }, icon("cube"), el("span", {}, "edit3r")),
    el("h1", {}, scene),
    page.tools.above,
    el("span", { class: "grow" }),
    views,
    files,
    stripButton,
    objectsButton,
    historyButton,
    button("settings", "settings", page.drawers.openSettings, { key: "S" }),
    button("full", "full screen", fullScreen, { key: "F", class: "icon wide-only" }),
    button("help", "keys, and light or dark", () => showKeys(), {
      key: "?",
      class: "icon wide-only",
    }),
  );
  const { notice, node: verdicts } = page.verdicts;
  const over = el("div", { class: "over-stage" }, notice, verdicts, page.waiting.node);
  const gestures = el(
    "p",
    { class: "gestures" },
    el("span", { class: "by-mouse" }, "Drag to turn · wheel to zoom · right drag to shift · click to mark"),
    el("span", { class: "by-finger" }, "Drag to turn · pinch to zoom · two fingers shift · tap to mark"),
  );
  const middle = el("div", { class: "middle" }, stage, gestures, over, page.adjust.node, page.sculpt.node, page.ruler.node, page.question.node);
  root.replaceChildren(top, el("main", {}, strip, middle, page.drawers.node), dock);

  // ---- following the server ----
  let timer = 0,
    drawn = ""; // what of the photos is drawn
  async function refresh() {
    clearTimeout(timer);
    try {
      const before = page.s?.draft;
      const found = await ask("scene", scene, { at });
      if (page.gone()) return;
      // What was marked meanwhile may be newer than this answer; the next one knows of it.
      if (before && page.s.draft !== before) found.draft = page.s.draft;
      follow(found);
    } catch (error) {
      if (page.gone()) return;
      lost(error.message);
    }
    const { s } = page;
    timer = setTimeout(refresh, s && (s.job || !s.reading.geometry) ? POLLED.soon : POLLED.later);
  }
  function follow(s) {
    const last = page.s,
      first = last === null,
      isMade = last && last.job && s.isRun;
    page.s = s;
    page.photo = Math.min(page.photo, Math.max(0, s.photos.length - 1));
    if (first) begin();
    if (isMade) page.view = "3d";
    const wanted = `${s.state} ${s.photos} ${s.fixed} ${s.job ? s.preview : ""}`;
    if (first || wanted !== drawn) {
      drawn = wanted;
      page.strip.draw();
      page.stage.draw();
    } else if (last.isRun !== s.isRun) page.stage.draw();
    page.waiting.draw();
    page.verdicts.drawNotice();
    if (first || JSON.stringify(last.history) !== JSON.stringify(s.history)) page.drawers.draw();
    if (first || last.draft.version !== s.draft.version) {
      page.draft.took(s.draft);
      if (!s.job && !s.byHand) page.draft.answer();
    }
    if (isMade) page.bar.takeSentence();
  }
  function begin() {
    for (const one of [top, dock]) one.classList.remove("unready"); // shown when they keep their place
    page.view = page.s.isRun ? "3d" : "photo";
    page.bar.begin();
    page.tools.draw();
    page.bar.drawChip();
  }
  function lost(text) {
    if (page.s) return page.waiting.trouble(text);
    stage.replaceChildren(
      el("p", { class: "empty problem" }, text, " ", allScenes({}, "All scenes")),
    );
  }
  refresh();
  return () => {
    page.stop.abort();
    clearTimeout(timer);
    page.bar.leave();
    page.adjust.leave();
    page.draft.leave();
    page.picture.leave();
    page.strip.leave();
    document.body.classList.remove("no-strip", "only-scene");
    delete document.body.dataset.view;
  };
}
