// Elements, icons, and what is told in passing.

// An element: properties that begin with "on" are handlers, the others attributes; false leaves one out.
export function el(tag, props = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(props)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined)
      made.setAttribute(key, value);
  }
  made.append(
    ...children.flat().filter((one) => one !== null && one !== undefined && one !== false),
  );
  return made;
}

const PATHS = {
  back: "M15 5l-7 7 7 7",
  close: "M6 6l12 12M18 6L6 18",
  photos: "M4 7h12v12H4zM8 4h12v12",
  history: "M4 12a8 8 0 1 0 3-6M4 4v4h4M12 8v5l3 2",
  download: "M12 4v11M7 11l5 5 5-5M5 20h14",
  settings: "M4 7h9M17 7h3M4 17h3M11 17h9M15 4v6M9 14v6",
  help: "M9 9a3 3 0 1 1 4 3c-1 .6-1 1-1 2M12 18v.5",
  full: "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5",
  point: "M6 3l12 9-6 1-3 6z",
  box: "M5 5h14v14H5z",
  brush: "M14 4l6 6-8 7H6v-5zM4 21h16",
  lasso: "M12 4c5 0 8 2.4 8 5.5S17 15 12 15s-8-2.4-8-5.5S7 4 12 4zM8 14.5c-2 1-2 4 .5 4S10 22 7 22",
  minus: "M5 12h14",
  plus: "M12 5v14M5 12h14",
  undo: "M9 6L4 11l5 5M4 11h10a6 6 0 0 1 0 12",
  redo: "M15 6l5 5-5 5M20 11H10a6 6 0 0 0 0 12",
  invert: "M12 4a8 8 0 1 0 0 16zM12 4a8 8 0 0 1 0 16",
  compare: "M12 3v18M9 8l-4 4 4 4M15 8l4 4-4 4",
  theme: "M12 4a8 8 0 1 0 8 8 6 6 0 0 1-8-8z",
  film: "M4 6h16v12H4zM8 6v12M16 6v12M4 12h16",
  phone: "M7 3h10v18H7zM11 18h2",
  things: "M4 8l5-3 5 3v6l-5 3-5-3zM4 8l5 3 5-3M9 11v6M17 12a3.5 3.5 0 1 0 .1 0",
  shown: "M2.5 12c5-8 14-8 19 0-5 8-14 8-19 0zM12 9a3 3 0 1 0 .1 0",
  hidden: "M2.5 12c5-8 14-8 19 0-5 8-14 8-19 0zM4 20L20 4",
  cube: "M12 3l8 4.5v9L12 21l-8-4.5v-9zM12 12l8-4.5M12 12v9M12 12L4 7.5",
  clear: "M5 7h14M10 7V4h4v3M7 7l1 13h8l1-13",
  add: "M12 5v14M5 12h14",
  upright: "M12 20V5M6 11l6-6 6 6M5 21h14",
  which: "M4 4h7v7H4zM13 4h7v7h-7zM4 13h7v7H4zM13 13h7v7h-7z",
  clean: "M20 4l-8 8M12 12l-3-3-6 6 6 6 6-6zM6 18l3-3M9 21l3-3",
  ruler: "M3 16L16 3l5 5L8 21zM7 12l2 2M10 9l3 3M13 6l2 2",
  keep: "M6 4h12v16l-6-4-6 4z",
  save: "M4 8h4l2-3h4l2 3h4v11H4zM12 10a3.5 3.5 0 1 0 .1 0",
  away: "M4 12a8 8 0 1 0 16 0 8 8 0 1 0-16 0M8 12h8",
};
export function icon(name) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  made.setAttribute("viewBox", "0 0 24 24");
  made.setAttribute("aria-hidden", "true");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", PATHS[name]);
  made.append(path);
  return made;
}

// A button with an icon; `key` is shown in its tooltip. With `text` the word stands beside.
export function button(name, label, onclick, { key = "", text = "", ...props } = {}) {
  if (!label.toLowerCase().includes(text.toLowerCase())) label = `${text}: ${label}`; // as it is seen
  const title = key ? `${label} (${key})` : label;
  return el(
    "button",
    { type: "button", class: "icon", title, "aria-label": label, onclick, ...props },
    icon(name),
    text && el("span", {}, text),
  );
}

export function toast(sentence, isProblem = false) {
  const close = el(
    "button",
    { type: "button", class: "icon", "aria-label": "close", onclick: () => note.remove() },
    icon("close"),
  );
  const note = el(
    "div",
    { class: isProblem ? "toast problem" : "toast" },
    el("span", {}, sentence),
    close,
  );
  const toasts = document.getElementById("toasts");
  toasts.replaceChildren(note);
  if (toasts.matches(":popover-open")) toasts.hidePopover();
  toasts.showPopover(); // above dialogs, too
  setTimeout(() => note.remove(), isProblem ? 12000 : 5000);
  // Who goes on has read it; who types may have typed before a problem was said.
  const goesOn = (event) => toasts.contains(event.target) || note.remove();
  const kinds = isProblem ? ["pointerdown"] : ["pointerdown", "input"];
  for (const kind of kinds) addEventListener(kind, goesOn, { once: true });
}

// A dialog of the browser's own, which keeps the focus and closes by Escape.
export function dialog(title, ...content) {
  const close = () => made.close();
  const head = el(
    "div",
    { class: "head" },
    el("h2", { id: "dialog-title" }, title),
    button("close", "close", close, { key: "Esc" }),
  );
  const made = el(
    "dialog",
    { "aria-labelledby": "dialog-title" },
    head,
    el("div", { class: "content" }, ...content),
  );
  made.addEventListener("click", (event) => {
    if (event.target === made) close();
  });
  made.addEventListener("close", () => made.remove());
  document.body.append(made);
  made.showModal();
  return made;
}

export const seconds = (value) =>
  value < 90 ? `${Math.max(1, Math.round(value))} s` : `${Math.round(value / 60)} min`;
export const size = (bytes) =>
  bytes >= 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.max(1, Math.round(bytes / 1e3))} kB`;

export function changeTheme() {
  const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  document.documentElement.dataset.theme = theme;
  localStorage.setItem("edit3r-theme", theme);
}
