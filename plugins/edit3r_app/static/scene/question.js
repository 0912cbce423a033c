// Which of several things is meant: asked once where it is unsure, and whenever somebody wants to see the others.
import { path } from "../api.js";
import { button, el } from "../dom.js";

export function questionOf(page) {
  const node = el("div", {
    class: "question",
    role: "group",
    "aria-label": "which one is meant",
    hidden: true,
  });
  let answered = 0; // the version of the answer that was not doubted
  const close = () => (node.hidden = true);
  function draw() {
    const { look } = page;
    const doubt = look.readings.length > 1 && !look.sure && answered !== look.version;
    node.hidden = !doubt;
    if (doubt) show("Is it this one?");
  }
  const word = (isTaken) => (isTaken ? "Yes, this one" : "This one");
  const choice = (number, taken, others) =>
    el(
      "button",
      {
        type: "button",
        class: "reading",
        "aria-pressed": String(number === taken),
        onclick: () => pick(number),
        "aria-label": `${word(number === taken)}: reading ${number} of ${others.length}`,
      },
      el("img", {
        src: `${path("reading", page.state(), String(number))}?v=${page.look.version}`,
        alt: "",
      }),
      el("span", {}, word(number === taken)),
    );
  function show(text) {
    const taken = page.s.draft.outline.reading,
      others = page.look.readings;
    node.hidden = false;
    node.replaceChildren(
      el("strong", {}, text),
      el(
        "div",
        { class: "row" },
        others.map((number) => choice(number, taken, others)),
      ),
      el(
        "div",
        { class: "row" },
        el("small", {}, "None of these? Point at it, or draw a box."),
        button("close", "close", () => {
          answered = page.look.version;
          close();
        }),
      ),
    );
  }
  async function pick(number) {
    close();
    if (number !== page.s.draft.outline.reading)
      await page.draft.change("step", ["reading", number]);
    answered = page.look.version;
    close();
  }
  return { node, draw, close, showOthers: () => show("Which one?") };
}
