// What is drawn over the finished scene: a brush and a lasso choose Gaussians, to be hidden, removed,
// kept alone, or taken as a thing.
import { tell } from "../api.js";
import { button, el } from "../dom.js";

export const SCULPTS = ["brush", "lasso"]; // tools that draw in 3D, too

export function sculptOf(page) {
  const node = el("div", { class: "question", role: "group", "aria-label": "what is drawn", hidden: true });
  let drawn = { strokes: 0, grown: 0, count: 0, bits: "" },
    hides = false,
    asking = 0;
  const is3d = () => page.s?.isRun && page.view === "3d" && !page.beside;
  const tool = () => (is3d() && SCULPTS.includes(page.tool) ? page.tool : "");

  async function change(kind, value) {
    const number = ++asking;
    page.waiting.busy(kind === "look" ? "" : "Looking for what you drew around");
    const found = await page.attempt(() => tell(["draw", page.state()], { do: kind, value }));
    page.waiting.busy("");
    if (number !== asking || page.gone()) return;
    if (found) drawn = found;
    if (!drawn.strokes) hides = false;
    show();
    page.tools.draw();
    page.drawers.followMarks();
  }
  function show() {
    page.viewer.post({ picked: drawn.bits, gone: hides });
    draw();
  }
  const stroke = (made, away) => change("stroke", { ...made, minus: page.minus !== Boolean(away) });
  const act = (name, text, label, onclick, more = {}) => button(name, label, onclick, { text, class: "icon tool", ...more });
  const shape = (action) => page.things.shape(action, "");
  function hide() {
    hides = !hides;
    show();
  }
  function draw() {
    node.hidden = !is3d() || !drawn.strokes;
    page.viewer.post({ drawing: tool(), radius: page.brush });
    if (node.hidden) return;
    const some = drawn.count > 0;
    node.replaceChildren(
      el("strong", {}, some ? `${drawn.count.toLocaleString("en")} points chosen` : "Nothing of the scene lies there."),
      el(
        "div",
        { class: "row" },
        act("minus", "Shrink", "leave out the rim", () => change("grow", -1)),
        act("plus", "Grow", "take in what lies around", () => change("grow", 1)),
        act(hides ? "hidden" : "shown", hides ? "Show" : "Hide", hides ? "show it again" : "hide it for now", hide),
        act("clear", "Remove", "remove it from the scene", () => shape("cut"), { disabled: !some }),
        act("keep", "Keep only", "remove all else from the scene", () => shape("crop"), { disabled: !some }),
        act("things", "Take", "take it as a thing", () => page.drawers.toggle("objects", true), { disabled: !some }),
        act("close", "Clear", "forget what is drawn", () => change("clear")),
      ),
    );
  }
  return {
    node,
    draw,
    stroke,
    show,
    has: () => drawn.strokes > 0 && is3d(),
    back: () => change("undo"),
    restore: () => is3d() && change("look"),
  };
}
