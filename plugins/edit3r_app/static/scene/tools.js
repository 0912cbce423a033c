// How to point, and what to do with what is selected.
import { button, el, toast } from "../dom.js";
import { SCULPTS } from "./sculpt.js";

const TOOLS = {
  point: ["Point: click the thing, or draw a line over it", "P"],
  box: ["Box: draw it around the thing", "B"],
  brush: ["Brush: takes exactly what it covers", "R"],
  lasso: ["Lasso: takes exactly what you draw around", "L"],
};
const tool = (name, text, label, act, key, more = {}) =>
  button(name, label, act, { key, text, class: "icon tool", ...more });
const pressed = (name, text, is, label, act, key) =>
  tool(name, text, label, act, key, { "aria-pressed": String(is) });
// One that says why where it cannot act.
const able = (name, text, label, act, key, can, why, more = {}) =>
  tool(name, text, can ? label : `${label}: ${why}`, () => (can ? act() : toast(why, true)), key, {
    "aria-disabled": String(!can),
    ...more,
  });
const BRUSHES = [0.004, 0.1]; // radii, of the longer side
const gap = () => el("span", { class: "gap" });

export function toolsOf(page) {
  const node = el("div", { class: "tools", role: "toolbar", "aria-label": "how to point" });
  function take(name, stays = false) {
    const draws = SCULPTS.includes(name) && page.s.isRun;
    if (page.s.byHand && !draws) return;
    page.ruler.close();
    // points and draws on photos and in 3D; for the box the photos come first
    page.tool = name;
    if (name === "box" || (SCULPTS.includes(name) && !page.s.isRun)) page.view = "photo";
    draw();
    if (!stays) page.stage.draw();
  }
  const flip = (what) => () => {
    page[what] = !page[what];
    draw();
  };
  function wider(times) {
    if (page.tool !== "brush") return;
    page.brush = Math.min(BRUSHES[1], Math.max(BRUSHES[0], page.brush * times));
    draw();
  }
  const offered = ([name]) => !page.s.byHand || SCULPTS.includes(name);
  const isTaken = (name) => page.tool === name && !page.ruler.is() && (page.view === "photo" || name === "point" || (name !== "box" && page.s.isRun));
  const pointers = () => [
    ...Object.entries(TOOLS).filter(offered).map(([name, [label, key]]) =>
      pressed(name, label.split(":")[0], isTaken(name), label, () => take(name), key),
    ),
    ...(page.tool === "brush"
      ? [
          tool("minus", "Thinner", "a thinner brush", () => wider(0.75), "["),
          tool("plus", "Wider", "a wider brush", () => wider(4 / 3), "]"),
        ]
      : []),
    page.tool === "box"
      ? pressed(
          "keep",
          "Exactly",
          page.exact,
          "exactly this box, without looking for the thing in it",
          flip("exact"),
          "E",
        )
      : "",
    pressed(
      "away",
      "Minus",
      page.minus,
      "take away instead of adding (or hold Shift)",
      flip("minus"),
      "X",
    ),
  ];
  // In the bar above, on phones beside the tools.
  const above = el("span", { class: "back wide-only" });
  const ofScene = () => [
    ...(page.s.isRun && page.view === "3d"
      ? [
          tool(
            "clean",
            "Clean",
            "take out floaters: points that hang in front of everything the photos show",
            () => page.things.shape("clean", ""),
            "",
          ),
        ]
      : []),
    ...(page.ruler.can()
      ? [
          pressed(
            "ruler",
            "Ruler",
            page.ruler.is(),
            "ruler: how far apart two places of the scene are",
            () => page.ruler.toggle(),
            "K",
          ),
        ]
      : []),
  ];
  function back(more = {}) {
    const { undo, redo, canUndo, canRedo } = page.draft;
    const nothing = "there is nothing to take back";
    return [
      able("undo", "Undo", "undo", undo, "Ctrl-Z", canUndo(), nothing, more),
      able("redo", "Redo", "redo", redo, "Ctrl-Y", canRedo(), "nothing was taken back", more),
    ];
  }
  function ofSelection() {
    const { s, look } = page,
      { larger, change, openNames } = page.draft;
    const selected = s.draft.selects || (look && look.selected),
      nothing = "nothing is selected yet";
    return [
      able("minus", "Smaller", "something smaller", () => larger(-1), "-", selected, nothing),
      able("plus", "Larger", "something larger", () => larger(1), "+", selected, nothing),
      able(
        "which",
        "Others",
        "what else may be meant",
        page.question.showOthers,
        "W",
        look && look.candidates.length > 1,
        "there is one candidate only",
      ),
      able(
        "invert",
        "Inverse",
        "all but this",
        () => change("step", ["invert", 0]),
        "I",
        selected,
        nothing,
      ),
      able(
        "keep",
        "Names",
        "keep what is marked by a name, or take it again",
        openNames,
        "N",
        s.draft.marks.length || s.draft.named.length,
        "mark something first",
      ),
    ];
  }
  function draw() {
    const small = back({ class: "icon tool small-only" });
    above.replaceChildren(...back());
    page.sculpt.draw();
    page.ruler.draw();
    if (page.s.byHand) return node.replaceChildren(...pointers(), ...ofScene(), ...small);
    const active = document.activeElement;
    const focused = active && node.contains(active) ? [...node.children].indexOf(active) : -1;
    node.replaceChildren(...pointers(), ...ofScene(), ...small, gap(), ...ofSelection());
    if (focused >= 0) node.children[focused]?.focus();
    page.picture.box.dataset.tool = page.tool;
  }
  return { node, above, take, wider, draw };
}
