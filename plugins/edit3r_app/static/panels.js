// What opens over the scene: history, settings, downloads, keys.
import { go, sceneAddress } from "./address.js";
import { path, tell } from "./api.js";
import { button, changeTheme, dialog, el, icon, size, toast } from "./dom.js";

const WORD = {
  queued: "waits",
  running: "being made",
  failed: "did not work",
  cancelled: "cancelled",
};

export function showHistory(drawer, s, close) {
  const here = s.state,
    steps = [];
  if (!s.fromRun)
    steps.push(
      step(
        s,
        {
          name: s.scene,
          depth: -1,
          prompt: s.isSplat ? "The scene as it came" : "The photos as they are",
          photo: "",
          state: "done",
          verdicts: [],
          set: [],
        },
        path("thumbnail", s.scene, s.photos[0] || ""),
      ),
    );
  for (const one of s.history)
    steps.push(step(s, one, one.photo ? path("image", one.name, "renders", one.photo) : ""));
  drawer.replaceChildren(
    el("div", { class: "head" }, el("h2", {}, "History"), button("close", "close", close, { key: "Esc" })),
    el("ol", {}, steps),
    s.history.length
      ? ""
      : el(
          "p",
          { class: "quiet" },
          "Every edit is kept here. One of an earlier state begins a branch.",
        ),
  );
  drawer.querySelector('[aria-current="page"]')?.scrollIntoView({ block: "nearest" });

  function step(all, one, image) {
    const labels = one.verdicts.map(({ on, label, reason }) =>
      el("span", { class: "badge", "data-label": label, title: reason }, `${on}: ${label}`),
    );
    const words = one.state === "done" ? labels : el("span", { class: "badge" }, WORD[one.state]);
    const item = el(
      "li",
      { style: `margin-left:${Math.min(6, one.depth + 1) * 14}px` },
      el(
        "a",
        {
          href: sceneAddress(all.scene, one.name),
          "data-ours": true,
          "aria-current": one.name === here ? "page" : false,
        },
        el("span", { class: "cover" }, image ? el("img", { src: image, alt: "" }) : icon("cube")),
        el(
          "span",
          { class: "text" },
          el("strong", {}, one.prompt || "no edit"),
          el("span", { class: "badges" }, words),
          one.set.length ? el("small", {}, one.set.join(" · ")) : "",
          one.sentence ? el("small", { class: "problem" }, one.sentence) : "",
        ),
      ),
    );
    if (all.isRun && one.state === "done" && one.name !== here && one.name !== all.scene)
      item.append(
        button("compare", `beside: ${one.prompt || one.name}`, () =>
          go(sceneAddress(all.scene, here, one.name)),
        ),
      );
    return item;
  }
}

// ---- settings ----

export function showSettings(groups, set, again) {
  const content = el("div", { class: "settings" });
  const draw = (found) =>
    content.replaceChildren(
      ...found.map(({ title, group, fields }) =>
        title === "For experts" || title.startsWith("Settings of")
          ? el(
              "details",
              {},
              el("summary", {}, title),
              fields.map((one) => field(group, one)),
            )
          : el(
              "section",
              {},
              title && el("h3", {}, title),
              fields.map((one) => field(group, one)),
            ),
      ),
    );
  async function keep(group, name, text) {
    await set(group, name, text);
    if (!group) draw(await again());
  }
  draw(groups);
  dialog("Settings", content);

  function field(group, one) {
    const id = `set-${group}-${one.name}`.replace(/\W/g, "-"),
      told = `${id}-told`;
    const label = el(
      "label",
      { for: id },
      one.label,
      one.unit ? el("small", {}, ` (${one.unit})`) : "",
    );
    const inside = { id, "aria-describedby": told };
    const number = () =>
      el("input", {
        ...inside,
        type: "number",
        value: one.value,
        placeholder: one.default || "automatic",
        min: one.min,
        max: one.max,
        step: one.step === 1 ? 1 : "any",
        onchange: (event) => keep(group, one.name, event.target.value),
      });
    const kinds = {
      switch: () =>
        el("input", {
          ...inside,
          type: "checkbox",
          role: "switch",
          checked: (one.value || one.default) === "true",
          onchange: (event) => keep(group, one.name, String(event.target.checked)),
        }),
      select: () =>
        el(
          "select",
          { ...inside, onchange: ({ target }) => (explain(target.value), keep(group, one.name, target.value)) },
          one.options.map(({ value, label: text }) =>
            el("option", { value, selected: value === (one.value || one.default || "") }, text),
          ),
        ),
      slider: () => {
        const value = one.value || one.default,
          shown = el("output", { for: id }, value);
        const slider = el("input", {
          ...inside,
          type: "range",
          min: one.min,
          max: one.max,
          step: one.step,
          value,
          oninput: () => {
            shown.textContent = slider.value;
          },
          onchange: () => keep(group, one.name, slider.value),
        });
        return el("span", { class: "slider" }, slider, shown);
      },
      number,
      text: () =>
        el("input", {
          ...inside,
          type: "text",
          value: one.value,
          placeholder: one.default || "automatic",
          maxlength: "2000",
          onchange: (event) => keep(group, one.name, event.target.value),
        }),
    };
    // What is chosen is explained below, where no line cuts it.
    const explained = el("small", { id: told }),
      explain = (value) =>
        (explained.textContent = one.options?.find((each) => each.value === value)?.told || one.help);
    explain(one.value || one.default || "");
    return el("div", { class: "field" }, label, kinds[one.kind](), explained);
  }
}

// ---- downloads ----

export const PLAYS_MP4 = Boolean(el("video").canPlayType('video/mp4; codecs="avc1.64001f"'));

// `film()` begins a flight of one's own, `phone()` shows the link for a phone.
export function showFiles(files, run, film, phone) {
  async function take(one, row) {
    if (row.getAttribute("aria-busy") === "true") return;
    row.setAttribute("aria-busy", "true");
    try {
      const bytes = await tell(["prepare", run], { file: one.file });
      row.querySelector(".size").textContent = size(bytes);
      el("a", { href: path("download", run, one.file), download: "" }).click();
    } catch (error) {
      toast(error.message, true);
    }
    row.removeAttribute("aria-busy");
  }
  const row = (one) => {
    const about = [one.keeps && `Keeps ${one.keeps}.`, one.loses && `Loses ${one.loses}.`]
      .filter(Boolean)
      .join(" ");
    const made = el(
      "button",
      { type: "button", class: "file", onclick: () => take(one, made) },
      el("strong", {}, one.file),
      el("span", { class: "size" }, one.bytes === null ? "made when asked for" : size(one.bytes)),
      el("span", {}, one.what),
      about ? el("small", {}, about) : "",
    );
    return made;
  };
  // One video is enough: the one that this browser plays.
  const video = files.find(({ file }) => file === (PLAYS_MP4 ? "video.mp4" : "video.webm"));
  for (const one of files) if (video && one.file.startsWith("video.")) one.usual = one === video;
  const other = (name, text, act) =>
    button(name, text, () => (shown.close(), act()), { text, class: "other" });
  const shown = dialog(
    "Download",
    el(
      "div",
      { class: "row" },
      other("film", "Film a flight", film),
      other("phone", "Open it on a phone", phone),
    ),
    el("p", {}, "viewer.html is the one file to send: it opens in any browser, without this app."),
    el("div", { class: "files" }, files.filter((one) => one.usual).map(row)),
    el(
      "details",
      {},
      el("summary", {}, "For other programs"),
      el("div", { class: "files" }, files.filter((one) => !one.usual).map(row)),
    ),
  );
}

// ---- on a phone ----

export function showPhone({ how, address, code }) {
  const holder = el("div", { class: "code", role: "img", "aria-label": "the address as a code" });
  holder.innerHTML = code;
  dialog(
    "Open it on a phone",
    ...(how
      ? [el("p", {}, how)]
      : [
          holder,
          el(
            "p",
            {},
            "Scan it with a phone in the same network. Whoever has the address can use this app:",
          ),
          el("pre", { tabindex: "0", "aria-label": "the address" }, address),
        ]),
  );
}

// ---- selections kept by a name ----

// `change(kind, name)` keeps, recalls or drops one and returns the names.
export function showNames(names, has, change) {
  const list = el("ul", { class: "names" }),
    field = el("input", {
      type: "text",
      "aria-label": "name of what is marked",
      placeholder: "Name of what is marked, such as: door",
      maxlength: "60",
      disabled: !has,
    });
  const draw = (found) =>
    list.replaceChildren(
      ...found.map((name) =>
        el(
          "li",
          {},
          el("button", { type: "button", onclick: () => take(name) }, name),
          button("clear", `forget ${name}`, async () => draw(await change("drop", name))),
        ),
      ),
    );
  const keep = async (event) => {
    event.preventDefault();
    if (!field.value.trim()) return field.focus();
    draw(await change("keep", field.value.trim()));
    field.value = "";
  };
  const shown = dialog(
    "Selections",
    el("p", {}, "Kept with the photos, for every edit of them. Press one to select it again."),
    list,
    el(
      "form",
      { class: "row", onsubmit: keep },
      field,
      el("button", { type: "submit", class: "primary", disabled: !has }, "Keep"),
    ),
  );
  const take = async (name) => {
    shown.close();
    await change("recall", name);
  };
  draw(names);
}

// ---- keys ----

const KEYS = [
  ["P · B · R · L", "point · box · brush · lasso"],
  ["X, or hold Shift", "take away instead of adding"],
  ["[ · ]", "a thinner brush · a wider one"],
  ["E", "exactly the box that is drawn"],
  ["+ · - · wheel", "something larger · smaller"],
  ["W", "what else may be meant"],
  ["I", "all but what is selected"],
  ["N", "selections kept by a name"],
  ["Ctrl-Z · Ctrl-Shift-Z", "undo · redo, of marks and edits"],
  ["1 to 9", "photo, or fly to where it was taken"],
  ["arrow keys, Enter", "on the photo: move a cross, point at it"],
  ["/ · Enter", "to the sentence · Go"],
  ["M", "photos or 3D"],
  ["Alt and drag", "in 3D: draw a line over the thing"],
  ["K in 3D", "measure between two places"],
  ["R · L in 3D", "choose points of the scene: hide, remove, keep, take"],
  ["C · B in 3D", "handle between before and after · switch"],
  ["arrows, W A S D in 3D", "turn and fly"],
  ["V · O · H · D · S", "photos · things · history · downloads · settings"],
  ["F · Esc", "the scene alone · back"],
];
export function showKeys() {
  dialog(
    "Keys",
    el(
      "dl",
      { class: "keys" },
      KEYS.flatMap(([keys, what]) => [el("dt", {}, keys), el("dd", {}, what)]),
    ),
    el("button", { type: "button", onclick: changeTheme }, "Light or dark"),
  );
}
