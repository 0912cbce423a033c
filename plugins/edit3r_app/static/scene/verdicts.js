// Over the scene: what is wrong with the photos, what is said of what was made, and what is compared.
import { go, sceneAddress } from "../address.js";
import { el } from "../dom.js";
import { choose } from "../upload.js";

const COMPARED = {
  none: "Compare: off",
  photos: "Compare: the photos",
  last: "Compare: the last state",
};

const NARROW = matchMedia("(max-width: 720px)"); // there the worst answer stands for all
const BAD = ["poor", "doubtful", "question", "failed"];

export function verdictsOf(page) {
  const compared = el("select", { "aria-label": "compare with", title: "before and after (C)" });
  compared.addEventListener("change", () => take(compared.value));
  const words = el("div", { class: "badges" });
  const node = el("div", { class: "verdicts", hidden: true }, compared, words);
  const notice = el("div", {
    class: "notice",
    role: "status",
    "aria-live": "polite",
    hidden: true,
  });
  const edit = () => page.s.history.find(({ name }) => name === page.state());

  function take(kind) {
    if (kind === "last") return go(sceneAddress(page.scene, page.state(), edit().parent));
    page.kept.compares = kind !== "none";
    if (page.beside) return go(sceneAddress(page.scene, page.state()));
    page.viewer.compare();
    draw();
  }
  function draw() {
    // a scene that was changed by hand has no colours of the photos
    const can = { none: true, photos: !page.s.byHand, last: Boolean(edit()?.parent) },
      kinds = Object.keys(COMPARED).filter((one) => can[one]),
      taken = page.beside ? "last" : page.kept.compares && can.photos ? "photos" : "none",
      said = edit()?.verdicts || [];
    node.hidden = document.body.dataset.view !== "3d" || !page.s.isRun;
    compared.hidden = kinds.length < 2;
    const key = JSON.stringify([kinds, taken, said, NARROW.matches]);
    if (node.dataset.key === key) return;
    node.dataset.key = key;
    compared.replaceChildren(
      ...kinds.map((value) => el("option", { value, selected: value === taken }, page.s.isSplat && value === "photos" ? "Compare: before" : COMPARED[value])),
    );
    words.replaceChildren(...(NARROW.matches && said.length > 1 ? [together(said)] : said.map(badge)));
  }
  const badge = ({ on, label, reason }) =>
    el(
      "details",
      { class: "badge", "data-label": label },
      el("summary", {}, `${on[0].toUpperCase()}${on.slice(1)}: ${label}`),
      el("p", {}, reason),
    );
  const together = (said) => {
    const worst = said.find(({ label }) => BAD.includes(label)) || said.at(-1);
    const one = badge(worst);
    one.replaceChildren(one.firstChild, ...said.map(({ on, label, reason }) => el("p", {}, `${on}: ${label}, ${reason}`)));
    return one;
  };
  function drawNotice() {
    const { trouble, placed } = page.s.reading;
    if (notice.dataset.text === trouble) return;
    notice.dataset.text = trouble;
    notice.hidden = !trouble;
    notice.replaceChildren(
      el(
        "strong",
        {},
        placed ? "These photos do not fit well." : "These photos cannot be placed in one scene.",
      ),
      el("span", {}, trouble),
      page.s.fixed || page.s.fromRun
        ? ""
        : el("button", { type: "button", onclick: () => choose(false, page.strip.add) }, "Add photos"),
    );
  }
  const toggle = () => take(page.kept.compares && !page.beside ? "none" : "photos");
  const close = () => words.querySelectorAll("[open]").forEach((one) => (one.open = false));
  return { node, notice, draw, drawNotice, toggle, close };
}
