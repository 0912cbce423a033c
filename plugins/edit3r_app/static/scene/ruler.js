// A length of the scene: two places that are clicked in 3D, and how far apart they are in truth.
import { button, el } from "../dom.js";

export function rulerOf(page) {
  const node = el("form", { class: "question", "aria-label": "a length", hidden: true });
  let measures = false;
  const can = () => page.s?.isRun && !page.s.isSplat && page.view === "3d" && !page.beside;
  const is = () => measures && can();
  function toggle(wanted = !measures) {
    if (wanted && !can()) return;
    measures = wanted;
    ask();
    page.tools.draw();
  }
  // Also after the page of the scene came anew.
  function ask() {
    page.viewer.post({ measuring: is() });
    fill("Click two places in the scene.");
  }
  // What the scene's page measured; it may be a stranger's.
  function measured({ apart, unit }) {
    const length = Number(apart);
    if (!is() || !(length > 0 && length < Infinity)) return;
    const shown = `${Number(length.toPrecision(3))} ${unit === "m" ? "m" : "units"}`;
    const typed = el("input", {
      type: "text",
      name: "length",
      size: 10,
      placeholder: "69.4 cm",
      "aria-label": "how long it is in truth: m, cm, mm, ft or in",
      autocomplete: "off",
    });
    node.onsubmit = (event) => {
      event.preventDefault();
      page.things.shape("measure", "", { text: `${length.toPrecision(6)}=${typed.value.trim()}` });
    };
    fill(
      `${shown} in the scene`,
      el("div", { class: "row" }, typed, el("button", { class: "primary" }, "Use it")),
      el("small", {}, "Type how long it is, to have all lengths in metres."),
    );
    typed.focus();
  }
  function fill(text, ...content) {
    draw();
    const head = [el("strong", {}, text), button("close", "close", close, { key: "Esc" })];
    node.replaceChildren(el("div", { class: "row" }, ...head), ...content);
  }
  const draw = () => (node.hidden = !is());
  const close = () => measures && toggle(false);
  return { node, can, is, draw, ask, toggle, measured, close };
}
