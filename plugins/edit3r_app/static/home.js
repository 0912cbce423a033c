// The first page: what this is, how to take photos that work, and the scenes that are there.
import { go, ROOT, sceneAddress } from "./address.js";
import { ask, path, tell } from "./api.js";
import { button, changeTheme, dialog, el, icon, toast } from "./dom.js";
import { ADVICE, STORY } from "./pictures.js";
import { choose, dropAnywhere, send } from "./upload.js";

const drawn = (svg) => {
  const holder = el("div", { class: "picture" });
  holder.innerHTML = svg;
  return holder;
};

export function home(page) {
  document.title = "edit3r";
  document.body.className = "home";
  const told = el("p", { class: "told", role: "status", "aria-live": "polite" });
  const scenes = el("ul", { class: "scenes" }),
    yours = el("section", { hidden: true }, el("h2", {}, "Your scenes"), scenes);
  const essentials = el("section", { hidden: true });

  async function take(files, folder) {
    if (!files.length)
      return toast(
        "There is no photo among these; expected JPEG, PNG, WebP, TIFF, AVIF or a video.",
        true,
      );
    // The page of the scene opens with its first photo; the others arrive there.
    const { scene, refused } = await send(
      files,
      "",
      folder,
      (text) => {
        told.textContent = text;
      },
      (begun) => go(sceneAddress(begun)),
    );
    const sentences = refused.slice(0, 10);
    if (refused.length > 10) sentences.push(`and ${refused.length - 10} more`);
    if (scene) return sentences.length && toast(sentences.join(" "), true);
    told.replaceChildren(...sentences.map((text) => el("span", { class: "problem" }, text)));
  }
  const tries = el("ul", { class: "scenes tries" });
  async function openMade(name, button) {
    button.disabled = true;
    try {
      const { scene, at } = await tell(["made", name]);
      go(sceneAddress(scene, at));
    } catch (error) {
      button.disabled = false;
      toast(error.message, true);
    }
  }
  const madeCard = ({ name, title, prompt }) => {
    const made = el(
      "button",
      { type: "button", class: "try", onclick: () => openMade(name, made) },
      el("span", { class: "cover" }, el("img", { src: path("made", name), alt: "" })),
      el("span", { class: "name" }, title),
      el("small", {}, `“${prompt}”`),
    );
    return el("li", {}, made);
  };

  page.replaceChildren(
    el(
      "header",
      { class: "top" },
      el("a", { href: ROOT, "data-ours": true, class: "brand" }, icon("cube"), "edit3r"),
      el("span", { class: "grow" }),
      button("theme", "dark or light", changeTheme),
    ),
    el(
      "main",
      {},
      el(
        "section",
        { class: "hero" },
        el("h1", {}, "Change one thing in two photos, and see it in 3D."),
        el(
          "p",
          {},
          "Point at a thing and say how it should change: edit3r changes it in every photo and builds the scene in 3D. Everything runs on this machine; nothing is sent anywhere.",
        ),
        el(
          "div",
          { class: "drop" },
          el("strong", {}, "Drop two or more photos of one scene here, or a folder of them"),
          el(
            "div",
            { class: "row" },
            el(
              "button",
              { type: "button", class: "primary", onclick: () => choose(false, take) },
              "Choose photos",
            ),
            el("button", { type: "button", onclick: () => choose(true, take) }, "Choose a folder"),
          ),
          el("small", {}, "JPEG, PNG, WebP, TIFF, AVIF, or a video; up to 60 photos of 100 MB. Or a splat: PLY, SPZ, SOG, splat, GLB."),
        ),
        told,
      ),
      el(
        "section",
        { class: "story unready" },
        STORY.map(([svg, title, text]) =>
          el("figure", {}, drawn(svg), el("figcaption", {}, el("strong", {}, title), " ", text)),
        ),
      ),
      el(
        "section",
        { class: "unready" },
        el("h2", {}, "Or open one of these"),
        el(
          "p",
          {},
          "The first time, this machine takes half a minute to make one; after that it opens at once.",
        ),
        tries,
      ),
      yours,
      el(
        "section",
        { class: "unready" },
        el("h2", {}, "Photos that work"),
        el(
          "div",
          { class: "advice" },
          ADVICE.map(([svg, works, text]) =>
            el(
              "figure",
              { class: works ? "good" : "bad" },
              drawn(svg),
              el("figcaption", {}, el("strong", {}, works ? "Works: " : "Does not: "), text),
            ),
          ),
        ),
      ),
      essentials,
    ),
  );

  const story = page.querySelector(".story");
  let timer = 0,
    gone = false;
  async function refresh() {
    try {
      const found = await ask("home");
      if (gone) return;
      // Who comes back sees the own scenes first; nothing is moved that was seen.
      if (found.scenes.length && story.classList.contains("unready")) story.before(yours);
      if (!tries.children.length) tries.replaceChildren(...found.made.map(madeCard));
      yours.hidden = !found.scenes.length;
      scenes.replaceChildren(...found.scenes.map((one) => card(one, refresh)));
      showEssentials(essentials, found.essentials, refresh);
      if (found.essentials.fetching) timer = setTimeout(refresh, 700);
    } catch (error) {
      toast(error.message, true);
    }
    for (const one of page.querySelectorAll(".unready")) one.classList.remove("unready");
  }
  refresh();
  const stop = dropAnywhere(take);
  return () => {
    gone = true;
    clearTimeout(timer);
    stop();
  };
}

function card({ name, photos, count, edits, at, shown }, refresh) {
  const source = shown.length
    ? path("image", at, "renders", shown[0])
    : photos.length && path("thumbnail", name, photos[0]);
  const image = source ? el("img", { src: source, alt: "", loading: "lazy" }) : icon("photos");
  const facts = `${count} photo${count === 1 ? "" : "s"}, ${edits} edit${edits === 1 ? "" : "s"}`;
  return el(
    "li",
    {},
    el(
      "a",
      { href: sceneAddress(name, at), "data-ours": true },
      el("span", { class: "cover" }, image),
      el("span", { class: "name" }, name),
      el("small", {}, facts),
    ),
    button("clear", `delete ${name}`, () => askToDelete(name, facts, refresh), { class: "icon out" }),
  );
}
function askToDelete(name, facts, refresh) {
  async function act() {
    asked.close();
    try {
      await tell(["delete", name]);
      toast(`${name} is deleted.`);
    } catch (error) {
      toast(error.message, true);
    }
    refresh();
  }
  const asked = dialog(
    `Delete ${name}?`,
    el(
      "p",
      {},
      `Everything made from it is deleted too: ${facts}. The files stay in the folder .deleted of the jobs folder until you empty it.`,
    ),
    el(
      "div",
      { class: "row" },
      el("button", { type: "button", onclick: act }, "Delete"),
      el("button", { type: "button", class: "primary", onclick: () => asked.close() }, "Cancel"),
    ),
  );
}

let agreed = false;
function showEssentials(place, { missing, fetching, lines }, refresh) {
  place.hidden = !missing.length && !lines.length;
  if (place.hidden) return;
  const megabytes = missing.reduce((sum, one) => sum + one.megabytes, 0);
  const again = () => showEssentials(place, { missing, fetching, lines }, refresh);
  place.replaceChildren(
    el("h2", {}, "Better outlines and depth"),
    el("p", {}, `${missing.length} small networks (${megabytes} MB) select and match far better.`),
    agreed
      ? el(
          "ul",
          {},
          missing.map((one) =>
            el("li", {}, `${one.name}: ${one.purpose} `, el("small", {}, one.terms)),
          ),
        )
      : el(
          "button",
          {
            type: "button",
            onclick: () => {
              agreed = true;
              again();
            },
          },
          "Fetch what makes a CPU complete",
        ),
    agreed && missing.length
      ? el(
          "button",
          {
            type: "button",
            class: "primary",
            disabled: fetching,
            onclick: () =>
              tell(["essentials"]).then(refresh, (error) => toast(error.message, true)),
          },
          "Accept the licences and fetch",
        )
      : "",
    lines.length
      ? el("pre", { tabindex: "0", "aria-label": "what was said while fetching" }, lines.join("\n"))
      : "",
  );
}
