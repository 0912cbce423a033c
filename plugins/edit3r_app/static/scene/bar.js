// The sentence, how it was understood, and Go.
import { go, sceneAddress } from "../address.js";
import { tell } from "../api.js";
import { el, icon, toast } from "../dom.js";
import { arriving } from "../upload.js";

const LONG = 150; // characters that are shown at once
const BY_HAND = "Changed by hand: go on with Things, or return to an earlier state to say more.";
const FEW = "One more photo at least, taken from another place.";

export function barOf(page) {
  const { scene, at } = page;
  const said = el("input", {
    type: "text",
    placeholder: "e.g. paint it golden",
    "aria-label": "what to change",
    maxlength: "2000",
    autocomplete: "off",
    enterkeyhint: "go",
  });
  const chip = el("button", {
    type: "button",
    class: "chip",
    onclick: () => page.draft.change("select", ""),
  });
  const goButton = el("button", { type: "submit", class: "primary" }, "Go");
  const line = el("div", { class: "line", role: "status", "aria-live": "polite" });
  const node = el(
    "div",
    { class: "saying" },
    el("div", { class: "understood" }, line),
    el("form", { class: "bar", onsubmit: submit }, chip, said, goButton),
  );

  function drawUnderstood() {
    const { look, s } = page,
      { understood: text, problem, judged, confidence } = look;
    const asked = s.draft.form.prompt || s.draft.selects;
    line.classList.toggle("problem", Boolean(problem && asked));
    if (problem && asked) return say(problem);
    const parts = [(text && `Understood: ${text}`) || hint()];
    if (confidence !== null)
      parts.push(`selected: confidence ${Math.round(100 * confidence)}%`);
    if (judged)
      parts.push(`edit: ${judged.label}, ${judged.reason}`);
    say(parts.join(" · "));
  }
  // A long text begins with its first sentence; the others are a press away.
  function say(text) {
    const first = text.length > LONG ? /^.{20,}?[.!?](?= )/.exec(text)?.[0] : null;
    line.replaceChildren(first || text);
    if (first)
      line.append(el("details", {}, el("summary", {}, "More"), text.slice(first.length + 1)));
  }
  // What was said of the words before is not said of these.
  function forget() {
    page.look = null;
    page.draft.newWords();
    line.classList.remove("problem");
    say(said.value.trim() ? "Reading your words" : hint());
    page.picture.setEdit("");
    page.question.close();
  }
  const hint = () =>
    page.s.byHand
      ? BY_HAND
      : page.s.photos.length < 2
      ? FEW
      : page.s.draft.selects
        ? "Now say what should change."
        : "Click the thing, or name it.";
  function drawChip() {
    const has = page.s.draft.selects;
    chip.hidden = page.s.byHand;
    const by = has ? "marked" : page.look && page.look.selected ? "named" : "";
    const confidence = by && page.look ? page.look.confidence : null;
    const found = confidence == null ? "" : `, ${Math.round(100 * confidence)}%`;
    chip.replaceChildren(
      ...(by
        ? [el("span", {}, el("span", { class: "wide-only" }, "what you "), by + found)]
        : ["nothing marked"]),
      has ? icon("close") : "",
    );
    chip.disabled = !has;
    chip.title = has ? "forget what is marked" : "point at the photo, or name the thing";
  }

  let typing = 0;
  said.addEventListener("input", () => {
    clearTimeout(typing);
    page.typed = performance.now();
    forget();
    typing = setTimeout(() => page.draft.change("say", said.value), 200);
  });
  async function submit(event) {
    event.preventDefault();
    clearTimeout(typing);
    if (page.s.photos.length < 2 || arriving.has(scene)) {
      // Whoever types faster than photos arrive means all of them.
      goButton.disabled = true;
      page.waiting.long("Begins when all photos are here");
      await arriving.get(scene)?.all;
      await page.refresh();
      page.waiting.long("");
      goButton.disabled = false;
      if (page.gone()) return;
    }
    if (page.s.photos.length < 2) return toast(FEW, true);
    if (!said.value.trim() && !page.s.draft.form.editor) {
      said.focus();
      return toast("Say first what should change, for example: paint it golden.", true);
    }
    goButton.disabled = true;
    page.question.close();
    page.waiting.long("Beginning");
    const job = await page.attempt(() => tell(["go", scene], { at, say: said.value }));
    goButton.disabled = false;
    page.waiting.long("");
    if (job) go(sceneAddress(scene, job));
  }
  function begin() {
    const { s } = page;
    takeSentence();
    if (s.isRun) said.placeholder = "e.g. make it blue";
    if (!s.byHand) return;
    // a sentence edits photos, and none shows what was changed by hand
    said.placeholder = "";
    say(BY_HAND);
    said.disabled = goButton.disabled = true;
  }
  const takeSentence = () => (said.value = page.s.draft.form.prompt || "");
  return {
    node,
    begin,
    takeSentence,
    drawUnderstood,
    drawChip,
    focus: () => said.focus(),
    leave: () => clearTimeout(typing),
  };
}
