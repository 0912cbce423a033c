// Which of several things is meant: asked once where it is unsure, where words found nothing, and
// whenever somebody wants to see the others.
import { ask, path } from "../api.js";
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
    const { look, s } = page;
    if (answered === look.version) return;
    const words = s.draft.form.prompt && !s.draft.selects;
    if (look.candidates.length > 1 && !look.sure) {
      show("Is it this one?");
      if (words) ready("suggestions");
    } else if ((look.asks || !look.sure) && words) point("The words do not say what to change.");
    else close();
  }
  // The next click takes what it hits.
  function ready(asks) {
    page.minus = false;
    page.tools.take("point", true);
    node.dataset.asks = asks;
  }
  const picture = (source, text, label, taken, onclick) =>
    el(
      "button",
      {
        type: "button",
        class: "candidate",
        "aria-pressed": String(taken),
        onclick,
        "aria-label": label,
      },
      el("img", { src: source, alt: "" }),
      el("span", {}, text),
    );
  const ending = (text) =>
    el(
      "div",
      { class: "row" },
      el("small", {}, text),
      button("close", "close", () => {
        if (page.look) answered = page.look.version;
        close();
      }),
    );
  function show(text) {
    const taken = page.s.draft.outline.candidate,
      others = page.look.candidates;
    const word = (number) => (number === taken ? "Yes, this one" : "This one");
    const source = (number) =>
      `${path("candidate", page.state(), String(number))}?v=${page.look.version}`;
    const one = (number) =>
      picture(
        source(number),
        word(number),
        `${word(number)}: candidate ${number} of ${others.length}`,
        number === taken,
        () => pick(number),
      );
    fill(
      el("strong", {}, text),
      el("div", { class: "row" }, others.map(one)),
      ending("None of these? Click the thing, or draw a box around it."),
    );
  }
  // Pointing is asked for: the next click takes what it hits, or one of the things on the photo is picked.
  async function point(text) {
    if (!node.hidden && node.dataset.asks === "pointing")
      return void (node.firstChild.textContent = text);
    const where = page.view === "3d" ? "scene" : "photo",
      name = page.current(),
      row = el("div", { class: "row" }, el("small", {}, "Looking for things on this photo"));
    fill(
      el("strong", {}, text),
      el("span", {}, `Click the thing in the ${where}, or take one of these:`),
      row,
      ending("One click anywhere on it is enough."),
    );
    ready("pointing");
    const found = await ask("suggestions", page.state(), name).catch(() => []);
    const one = (mark, k) =>
      picture(
        path("suggestion", page.state(), name, String(k)),
        "This one",
        `this one: ${k + 1} of ${found.length}`,
        false,
        () => {
          close();
          page.picture.made({ kind: mark.kind, places: mark.places, radius: 0 }, name);
        },
      );
    row.replaceChildren(...found.map(one));
  }
  function fill(...content) {
    node.hidden = false;
    delete node.dataset.asks;
    node.replaceChildren(...content);
  }
  async function pick(number) {
    close();
    // Who is asked and says yes has chosen, too.
    if (number !== page.s.draft.outline.candidate || !page.look.sure)
      await page.draft.change("step", ["candidate", number]);
  }
  return { node, draw, close, point, showOthers: () => show("Which one?") };
}
