// A flight through the scene along views that the user chose, and its video.
import { button, el, icon, seconds } from "./dom.js";

export const MOST_VIEWS = 12;

// `acts`: {keys, add(), look(key), drop(key), make(), busy}.
export function showFilm(drawer, acts, close) {
  const { keys, busy } = acts;
  const item = (key, k) =>
    el(
      "li",
      { class: "row" },
      el(
        "button",
        { type: "button", class: "grow", onclick: () => acts.look(key) },
        `View ${k + 1}`,
      ),
      button("clear", `leave out view ${k + 1}`, () => acts.drop(key)),
    );
  const few = keys.length < 2;
  drawer.replaceChildren(
    el(
      "div",
      { class: "head" },
      el("h2", {}, "Film a flight"),
      button("close", "close", close, { key: "Esc" }),
    ),
    el(
      "p",
      { class: "quiet" },
      "Turn the scene to where the flight begins and add that view; then to where it goes on.",
    ),
    el("ol", { class: "keyviews" }, keys.map(item)),
    el(
      "div",
      { class: "row film" },
      el(
        "button",
        { type: "button", class: "other", disabled: busy || keys.length >= MOST_VIEWS, onclick: acts.add },
        icon("add"),
        "Add this view",
      ),
      el(
        "button",
        { type: "button", class: "primary grow", disabled: busy || few, onclick: acts.make },
        busy ? "Drawing it" : "Make the video",
      ),
    ),
    el(
      "div",
      { class: "thing" },
      el(
        "small",
        {},
        few
          ? "Add at least two views."
          : `About ${seconds(((keys.length - 1) * 24) / 18)} long; every frame is drawn, which takes a while.`,
      ),
    ),
  );
}
