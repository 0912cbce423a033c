// How much of the edit is taken, and how softly it begins: sliders beside the photo that shows it.
import { el } from "../dom.js";

export function adjustOf(page) {
  let off = false,
    waits = 0;
  const slider = (name, label, usual, most, shown) => {
    const value = el("output", {}),
      range = el("input", {
        type: "range",
        min: 0,
        max: most,
        step: most / 20,
        "aria-label": label.toLowerCase(),
      });
    const draw = () => {
      const typed = page.s.draft.form.settings?.run?.[name];
      if (document.activeElement !== range) range.value = typed || usual;
      value.textContent = shown(range.value);
    };
    range.addEventListener("input", () => {
      value.textContent = shown(range.value);
      clearTimeout(waits);
      waits = setTimeout(() => page.draft.adjust(name, range.value), 120);
    });
    return { node: el("label", {}, el("span", {}, label), range, value), draw };
  };
  const sliders = [
    slider("strength", "Strength", 1, 1, (value) => `${Math.round(100 * value)} %`),
    slider("feather", "Feather", 0, 20, (value) => `${value} px`),
  ];
  const shown = el("input", { type: "checkbox", checked: true });
  shown.addEventListener("change", () => {
    off = !shown.checked;
    page.picture.preview(Boolean(page.look));
  });
  const node = el(
    "div",
    { class: "adjust", role: "group", "aria-label": "how much of the edit", hidden: true },
    el("label", { class: "shown" }, shown, el("span", {}, "Show the edit")),
    sliders.map((one) => one.node),
  );
  function draw(is) {
    node.hidden = page.view !== "photo" || !(is || (off && page.look?.runs));
    for (const one of sliders) one.draw();
  }
  return { node, draw, isOff: () => off, leave: () => clearTimeout(waits) };
}
