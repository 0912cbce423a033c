// The sentence, how it was understood, and Go.
import { go, sceneAddress } from "../app.js";
import { tell } from "../api.js";
import { el, icon, toast } from "../dom.js";

const FEW = "One more photo at least, taken from another place.";

export function barOf(page) {
  const { scene, at } = page;
  const said = el("input", {
    type: "text",
    placeholder: "What shall change? Such as: paint it golden",
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
  const understood = el("p", { class: "understood", role: "status", "aria-live": "polite" });
  const node = el(
    "div",
    { class: "saying" },
    understood,
    el("form", { class: "bar", onsubmit: submit }, chip, said, goButton),
  );

  function drawUnderstood() {
    const { look, s } = page,
      { understood: text, problem, judged, confidence } = look;
    understood.className =
      problem && (s.draft.form.prompt || s.draft.selects) ? "understood problem" : "understood";
    const parts = [problem || (text && `Understood: ${text}`) || hint()];
    if (!problem && confidence !== null)
      parts.push(`found by its name, confidence ${Math.round(100 * confidence)} %`);
    if (!problem && judged)
      parts.push(
        `this edit looks ${judged.label}${judged.label === "good" ? "" : `: ${judged.reason}`}`,
      );
    const line = parts.join(" · ");
    understood.replaceChildren(line);
    understood.title = line;
    goButton.title = look.runs ? "make it (Enter)" : problem || hint();
  }
  const hint = () =>
    page.s.photos.length < 2
      ? FEW
      : page.s.draft.selects
        ? "Now say what shall change."
        : page.view === "3d"
          ? "Click the thing in the scene, or name it in your sentence."
          : "Click the thing on the photo, or name it in your sentence.";
  function drawChip() {
    const has = page.s.draft.selects;
    chip.hidden = page.s.byHand;
    const by = has ? "marked" : page.look && page.look.selected ? "named" : "";
    chip.replaceChildren(
      ...(by
        ? [el("span", {}, el("span", { class: "wide-only" }, "what you "), by)]
        : ["nothing marked"]),
      has ? icon("close") : "",
    );
    chip.disabled = !has;
    chip.title = has ? "forget what is marked" : "point at the photo, or name the thing";
  }

  let typing = 0;
  said.addEventListener("input", () => {
    clearTimeout(typing);
    typing = setTimeout(() => page.draft.change("say", said.value), 350);
  });
  async function submit(event) {
    event.preventDefault();
    clearTimeout(typing);
    if (page.s.photos.length < 2) return toast(FEW, true);
    if (!said.value.trim() && !page.s.draft.form.editor) {
      said.focus();
      return toast("Say what shall change first, such as: paint it golden.", true);
    }
    goButton.disabled = true;
    page.waiting.long("Beginning");
    const job = await page.attempt(() => tell(["go", scene], { at, say: said.value }));
    goButton.disabled = false;
    page.waiting.long("");
    if (job) go(sceneAddress(scene, job));
  }
  function begin() {
    const { s } = page;
    takeSentence();
    if (s.isRun) said.placeholder = "And what next? Such as: make it blue";
    if (!s.byHand) return;
    // a sentence edits photos, and none shows what was changed by hand
    said.placeholder = "Changed by hand: say more in a state before it, or go on with Things";
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
