// The things of a scene: chosen, moved by handles in 3D, painted, copied, hidden, removed.
import { button, el } from "./dom.js";

const COLOURS = ["red", "orange", "golden", "green", "teal", "blue", "purple", "white", "black"];
const SHOWN = { golden: "#d9a520" };
const BESIDE = 0.15; // where a copy is put, to the right, as a share of the scene's depth

// `acts`: {chosen, hidden, choose(name), hide(name), ask(action, name, {numbers, text}), busy}.
export function showObjects(drawer, s, acts, close) {
  const { chosen } = acts;
  const field = (label, placeholder, done, word) => {
    const input = el("input", {
      type: "text",
      "aria-label": label,
      placeholder,
      maxlength: "60",
      autocomplete: "off",
    });
    const send = (event) => {
      event.preventDefault();
      if (input.value.trim()) done(input.value.trim());
      else input.focus();
    };
    return el(
      "form",
      { class: "row", onsubmit: send },
      input,
      el("button", { type: "submit", disabled: acts.busy }, word),
    );
  };
  const free = (name) => {
    for (let k = 2; ; k++) if (!s.objects.includes(`${name} ${k}`)) return `${name} ${k}`;
  };
  const details = () =>
    el(
      "div",
      { class: "thing" },
      el("small", {}, "In the scene: drag the handles to move, turn (↻) and resize (⤢) it."),
      el(
        "div",
        { class: "row swatches", role: "group", "aria-label": "paint it" },
        COLOURS.map((colour) =>
          el("button", {
            type: "button",
            style: `--swatch: ${SHOWN[colour] || colour}`,
            title: `paint it ${colour}`,
            "aria-label": `paint it ${colour}`,
            disabled: acts.busy,
            onclick: () => acts.ask("recolor", chosen, { text: colour }),
          }),
        ),
      ),
      field(
        "its colour",
        "Another colour: dark green",
        (text) => acts.ask("recolor", chosen, { text }),
        "Paint",
      ),
      field(
        "its name",
        `Another name for ${chosen}`,
        (text) => acts.ask("rename", chosen, { text }),
        "Rename",
      ),
      el(
        "div",
        { class: "row" },
        button(
          "add",
          "copy",
          () => acts.ask("copy", chosen, { text: free(chosen), numbers: [BESIDE, 0, 0] }),
          {
            text: "Copy",
            class: "",
            disabled: acts.busy,
          },
        ),
        button("clear", "remove", () => acts.ask("remove", chosen), {
          text: "Remove",
          class: "",
          disabled: acts.busy,
        }),
      ),
    );
  const item = (name) => {
    const isHidden = acts.hidden.has(name);
    return el(
      "li",
      { class: name === chosen ? "chosen" : "" },
      el(
        "div",
        { class: "row" },
        el(
          "button",
          {
            type: "button",
            class: "grow",
            "aria-pressed": String(name === chosen),
            onclick: () => acts.choose(name === chosen ? "" : name),
          },
          name,
        ),
        button(
          isHidden ? "hidden" : "shown",
          isHidden ? `show ${name}` : `hide ${name}`,
          () => acts.hide(name),
          {
            "aria-pressed": String(isHidden),
          },
        ),
      ),
      name === chosen ? details() : "",
    );
  };
  drawer.replaceChildren(
    el("div", { class: "head" }, el("h2", {}, "Things"), button("close", "close", close, { key: "Esc" })),
    s.objects.length
      ? el("ul", { class: "things" }, s.objects.map(item))
      : el("p", { class: "quiet" }, "No thing of this scene is known yet."),
    el(
      "div",
      { class: "thing" },
      s.byHand
        ? ""
        : el(
            "button",
            {
              type: "button",
              class: "primary",
              disabled: acts.busy,
              onclick: () => acts.ask("find", ""),
            },
            s.objects.length ? "Look for more" : "Find the things",
          ),
      acts.takes
        ? field(
            "name of the new thing",
            "What you marked is called…",
            (name) => acts.ask("add", name),
            "Take",
          )
        : el("small", {}, "Point at one, or draw around it (brush, lasso); then name it here."),
    ),
  );
}
