// The page of a scene: the scene, or before there is one the photo, fills it.
import { go, sceneAddress } from "./app.js";
import { ask, path, tell } from "./api.js";
import { button, el, icon, seconds, size, toast } from "./dom.js";
import { changeTheme } from "./home.js";
import { showFiles, showHistory, showKeys, showNames, showPhone, showSettings } from "./panels.js";
import { showFilm } from "./film.js";
import { showObjects } from "./objects.js";
import { pointing } from "./pointing.js";
import { choose, dropAnywhere, send } from "./upload.js";

const TOOLS = {
  point: ["Point: click the thing, or draw a line over it", "P"],
  box: ["Box: draw it around the thing", "B"],
  brush: ["Brush: takes exactly what it covers", "R"],
  lasso: ["Lasso: takes exactly what you draw around", "L"],
};
// Of the scene that was open last: the drawer and the chosen thing stay as they are with its next state.
const nothingKept = (scene) => ({ scene, drawer: "", chosen: "", hidden: new Set(), keys: [] });
let kept = nothingKept("");
const undone = new Map(); // of each scene: the states that undo went back from, the last one last
let looked = { scene: "", camera: null }; // where a scene was looked at last: its other states are seen from there
const ACTIONS = {
  add: "taking hold of it",
  remove: "removing it",
  recolor: "painting it",
  rename: "another name",
  move: "moving it",
  turn: "turning it",
  scale: "resizing it",
  copy: "copying it",
};
const OF_PAGE = ["f", "h", "i", "l", "m", "n", "o", "v", "x", "/", "?"]; // keys that 3D leaves to the page
const BRUSH = 0.03; // radius, of the photo's longer side

export function scenePage(page, scene, at, beside) {
  document.title = `${scene} · edit3r`;
  document.body.className = "studio";
  const stop = new AbortController(),
    on = { signal: stop.signal };
  let s = null,
    look = null,
    photo = 0,
    view = "photo",
    tool = "point",
    minus = false,
    exact = false,
    comparing = true,
    answered = 0,
    shown = "";
  const state = () => at || scene,
    current = () => s.photos[photo];
  const attempt = async (work) => {
    try {
      return await work();
    } catch (error) {
      toast(error.message, true);
      return null;
    }
  };

  // ---- what stands where ----
  const stage = el("section", { class: "stage", "aria-label": "the scene" });
  const pill = el("div", { class: "pill", role: "status", "aria-live": "polite", hidden: true });
  const question = el("div", {
    class: "question",
    role: "group",
    "aria-label": "which one is meant",
    hidden: true,
  });
  const strip = el("nav", { class: "strip", "aria-label": "photos" });
  const views = el("div", { class: "switch", role: "group", "aria-label": "what is shown" });
  const said = el("input", {
    type: "text",
    placeholder: "What shall change? Such as: paint it golden",
    "aria-label": "what to change",
    maxlength: "2000",
    autocomplete: "off",
    enterkeyhint: "go",
  });
  const chip = el("button", { type: "button", class: "chip", onclick: () => change("select", "") });
  const goButton = el("button", { type: "submit", class: "primary" }, "Go");
  const understood = el("p", { class: "understood", role: "status", "aria-live": "polite" });
  const tools = el("div", { class: "tools", role: "toolbar", "aria-label": "how to point" });
  const bar = el("form", { class: "bar", onsubmit: submit }, chip, said, goButton);
  const dock = el(
    "footer",
    { class: "dock unready" },
    tools,
    el("div", { class: "saying" }, understood, bar),
  );
  const drawer = el("aside", { class: "drawer", hidden: true });
  if (kept.scene !== scene) kept = nothingKept(scene);
  const files = button("download", "take it along", () => openFiles(), { key: "D" });
  const objectsButton = button("things", "things", () => toggleDrawer("objects"), {
    key: "O",
    "aria-expanded": "false",
    hidden: true,
  });
  const historyButton = button("history", "history", () => toggleDrawer("history"), {
    key: "H",
    "aria-expanded": "false",
  });
  const compareButton = button("compare", "before and after", () => compare(!comparing), {
    key: "C",
  });
  const top = el(
    "header",
    { class: "top" },
    el(
      "a",
      { href: "/", "data-ours": true, class: "brand", title: "all scenes" },
      icon("cube"),
      el("span", {}, "edit3r"),
    ),
    el("h1", {}, scene),
    el("span", { class: "grow" }),
    views,
    compareButton,
    files,
    button("photos", "photos", () => toggleStrip(), {
      key: "V",
      "aria-expanded": "true",
      class: "icon wide-only",
    }),
    objectsButton,
    historyButton,
    button("settings", "settings", () => openSettings(), { key: "S" }),
    button("full", "full screen", fullScreen, { key: "F", class: "icon wide-only" }),
    button("help", "keys, and light or dark", () => showKeys(changeTheme), {
      key: "?",
      class: "icon wide-only",
    }),
  );
  page.replaceChildren(
    top,
    el("main", {}, strip, el("div", { class: "middle" }, stage, pill, question), drawer),
    dock,
  );

  // ---- the photo, and pointing on it ----
  const base = el("img", { class: "base", alt: "", draggable: "false" }),
    over = el("img", { class: "over", alt: "", draggable: "false", hidden: true }),
    hover = el("img", { class: "over", alt: "", draggable: "false", hidden: true });
  const box = el(
    "div",
    {
      class: "box unready",
      tabindex: "0",
      role: "application",
      "aria-label": "the photo; arrow keys move a cross, Enter points at it",
    },
    base,
    over,
    hover,
  );
  const marks = pointing(box, () => ({ kind: tool, minus, exact, radius: BRUSH }), made, rests);
  function fit() {
    const [width, height] = [base.naturalWidth || 4, base.naturalHeight || 3],
      room = stage.getBoundingClientRect();
    const scale = Math.min(room.width / width, room.height / height);
    box.style.width = `${width * scale}px`;
    box.style.height = `${height * scale}px`;
    box.classList.toggle("unready", !base.naturalWidth);
    marks.draw();
  }
  base.addEventListener("load", fit);
  const resized = new ResizeObserver(fit);
  resized.observe(stage);
  const imageThere = (address) =>
    new Promise((done) => {
      const one = new Image();
      one.onload = () => done(true);
      one.onerror = () => done(false);
      one.src = address;
    });

  let hovered = 0,
    pressed = 0;
  async function rests(mark) {
    const number = ++hovered;
    if (!mark) return void (hover.hidden = true);
    if (!s || !s.reading.photos) return;
    const address = `${path("pointed", state(), current())}?v=${s.draft.version}&mark=${encodeURIComponent(JSON.stringify({ ...mark, photo: current() }))}`;
    if (!(await imageThere(address)) || number !== hovered) return;
    hover.src = address;
    hover.hidden = false;
  }
  async function made(mark, name = current()) {
    hovered++;
    pressed = performance.now();
    busy(s.reading.photos ? "Looking for what you mean" : "Reading the photos first");
    const before = s.draft.marks.concat({ ...mark, photo: name });
    marks.show(before.filter((one) => one.photo === current()));
    // The photo that was clicked is answered first, while the mark is written; then all the others.
    const pointed = encodeURIComponent(JSON.stringify({ ...mark, photo: name }));
    const address = `${path("pointed", state(), name)}?v=${s.draft.version}&made=1&mark=${pointed}`;
    const seen = imageThere(address).then((there) => {
      if (there && pressed) setOver(name, address); // else the full answer was there first
      hover.hidden = true;
    });
    const draft = await attempt(() =>
      tell(["draft", state()], { do: "mark", value: { ...mark, photo: name } }),
    );
    if (!draft) return void drawMarks();
    took(draft);
    await seen;
    await answer();
  }
  const drawMarks = () => marks.show(s.draft.marks.filter((one) => one.photo === current()));
  function setOver(name, address) {
    for (const image of strip.querySelectorAll("img.over"))
      if (image.dataset.photo === name) {
        image.src = address;
        image.hidden = false;
      }
    if (view === "3d") tint(name, address);
    if (name === current()) {
      over.src = address;
      over.hidden = view !== "photo";
    } else if (view !== "3d") return;
    if (pressed) document.body.dataset.outlined = Math.round(performance.now() - pressed); // [ms], for those who measure
    pressed = 0;
  }

  // What is selected on the photos is tinted in 3D: the viewer hears which of their pixels it covers.
  const tints = new Map();
  async function tint(name, address) {
    const image = new Image();
    image.src = address;
    await image.decode().catch(() => {});
    const { naturalWidth: width, naturalHeight: height } = image;
    if (width > 1) {
      const canvas = new OffscreenCanvas(width, height),
        ink = canvas.getContext("2d");
      ink.drawImage(image, 0, 0);
      const { data } = ink.getImageData(0, 0, width, height);
      const inside = Uint8Array.from({ length: width * height }, (_, k) =>
        Number(!data[4 * k + 3]),
      );
      tints.set(name, { name, width, height, inside });
    } else tints.delete(name);
    post({ selected: [...tints.values()] });
  }

  // ---- the draft: changed, then answered ----
  async function change(kind, value) {
    const draft = await attempt(() => tell(["draft", state()], { do: kind, value }));
    if (!draft) return;
    took(draft);
    await answer();
  }
  async function larger(way) {
    if (!s.draft.selects && !(look && look.selected))
      return toast("Nothing is selected yet: point at something first.", true);
    busy(way > 0 ? "Looking for something larger" : "Looking for something smaller");
    const draft = await attempt(() => tell(["step", state()], { value: way }));
    busy("");
    if (draft) {
      took(draft);
      await answer();
    }
  }
  function took(draft) {
    s.draft = draft;
    drawMarks();
    drawTools();
    drawChip();
  }
  let asking = 0,
    asked = null;
  async function answer() {
    // what the draft means, on every photo
    const number = ++asking;
    busy(s.draft.selects || s.draft.form.prompt ? "Finding it on every photo" : "");
    while (asked) await asked; // one question at a time: of those that wait the last is asked
    if (number !== asking || stop.signal.aborted) return;
    const version = s.draft.version,
      place = state();
    asked = attempt(() => ask("look", place, { v: version }));
    const found = await asked;
    asked = null;
    if (number !== asking) return;
    busy("");
    if (!found || stop.signal.aborted) return;
    look = found;
    drawUnderstood();
    drawChip();
    drawQuestion();
    drawTools();
    for (const name of s.photos) {
      const address = `${path("overlay", place, name)}?v=${found.version}`;
      imageThere(address).then((there) => {
        if (there && number === asking) setOver(name, address);
      });
    }
    if (!found.runs) return;
    const judged = await ask("verdict", place, { v: version }).catch(() => null);
    if (number === asking && judged) {
      look.judged = judged;
      drawUnderstood();
    }
  }

  // ---- the bar ----
  function drawUnderstood() {
    const { understood: text, problem, judged, surety } = look;
    understood.className =
      problem && (s.draft.form.prompt || s.draft.selects) ? "understood problem" : "understood";
    const parts = [problem || (text && `Understood: ${text}`) || hint()];
    if (!problem && surety !== null)
      parts.push(`found by its name, ${Math.round(100 * surety)} % sure`);
    if (!problem && judged)
      parts.push(
        `this edit looks ${judged.label}${judged.label === "good" ? "" : `: ${judged.reason}`}`,
      );
    const line = parts.join(" · ");
    understood.replaceChildren(line);
    understood.title = line;
    if (look.asks && s.draft.form.prompt)
      understood.append(
        " ",
        el(
          "button",
          { type: "button", class: "link", onclick: () => change("guess") },
          "Take what stands out most",
        ),
      );
    goButton.title = look.runs ? "make it (Enter)" : problem || hint();
  }
  const hint = () =>
    s.photos.length < 2
      ? "One more photo at least, taken from another place."
      : s.draft.selects
        ? "Now say what shall change."
        : view === "3d"
          ? "Click the thing in the scene, or name it in your sentence."
          : "Click the thing on the photo, or name it in your sentence.";
  function drawChip() {
    const has = s.draft.selects;
    chip.hidden = s.byHand;
    const by = has ? "marked" : look && look.selected ? "named" : "";
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
    typing = setTimeout(() => change("say", said.value), 350);
  });
  async function submit(event) {
    event.preventDefault();
    clearTimeout(typing);
    if (s.photos.length < 2)
      return toast("One more photo at least, taken from another place.", true);
    if (!said.value.trim() && !s.draft.form.editor) {
      said.focus();
      return toast("Say what shall change first, such as: paint it golden.", true);
    }
    goButton.disabled = true;
    busy("Beginning");
    const job = await attempt(() => tell(["go", scene], { at, say: said.value }));
    goButton.disabled = false;
    busy("");
    if (job) go(sceneAddress(scene, job));
  }
  function drawQuestion() {
    // what is unsure is asked once, with what else may be meant
    const doubt = look.readings.length > 1 && !look.sure && answered !== look.version;
    question.hidden = !doubt;
    if (doubt) askWhich("Is it this one?");
  }
  function askWhich(text) {
    const taken = s.draft.outline.reading,
      others = look.readings;
    question.hidden = false;
    question.replaceChildren(
      el("strong", {}, text),
      el(
        "div",
        { class: "row" },
        others.map((number) =>
          el(
            "button",
            {
              type: "button",
              class: "reading",
              "aria-pressed": String(number === taken),
              onclick: () => pick(number),
              "aria-label": `reading ${number} of ${others.length}${number === taken ? ", which is taken" : ""}`,
            },
            el("img", {
              src: `${path("reading", state(), String(number))}?v=${look.version}`,
              alt: "",
            }),
            el("span", {}, number === taken ? "Yes, this one" : "This one"),
          ),
        ),
      ),
      el(
        "div",
        { class: "row" },
        el("small", {}, "None of these? Point at it, or draw a box."),
        button("close", "close", () => {
          answered = look.version;
          question.hidden = true;
        }),
      ),
    );
  }
  async function pick(number) {
    question.hidden = true;
    if (number !== s.draft.outline.reading) await change("step", ["reading", number]);
    answered = look.version;
    question.hidden = true;
  }

  // ---- tools ----
  function take(name) {
    if (s.byHand) return;
    // points on photos and in 3D; for the others the photos come first
    tool = name;
    if (name !== "point") view = "photo";
    drawTools();
    drawStage();
  }
  function drawTools() {
    const selected = s.draft.selects || (look && look.selected);
    const tool3 = (name, text, label, act, key, more = {}) =>
      button(name, label, act, { key, text, class: "icon tool", ...more });
    const pressed = (name, text, is, label, act, key) =>
      tool3(name, text, label, act, key, { "aria-pressed": String(is) });
    const able = (name, text, label, act, key, can, why) =>
      tool3(
        name,
        text,
        can ? label : `${label}: ${why}`,
        () => (can ? act() : toast(why, true)),
        key,
        {
          "aria-disabled": String(!can),
        },
      );
    const flip = (act) => () => {
      act();
      drawTools();
    };
    const nothing = "nothing is selected yet";
    const focused =
      document.activeElement && tools.contains(document.activeElement)
        ? [...tools.children].indexOf(document.activeElement)
        : -1;
    const back = [
      able("undo", "Undo", "undo", undo, "Ctrl-Z", canUndo(), "there is nothing to take back"),
      able("redo", "Redo", "redo", redo, "Ctrl-Y", canRedo(), "nothing was taken back"),
    ];
    if (s.byHand) return tools.replaceChildren(...back);
    tools.replaceChildren(
      ...Object.entries(TOOLS).map(([name, [label, key]]) =>
        pressed(
          name,
          label.split(":")[0],
          tool === name && (view === "photo" || name === "point"),
          label,
          () => take(name),
          key,
        ),
      ),
      tool === "box"
        ? pressed(
            "keep",
            "Exactly",
            exact,
            "exactly this box, without looking for the thing in it",
            flip(() => (exact = !exact)),
            "E",
          )
        : "",
      pressed(
        "away",
        "Minus",
        minus,
        "take away instead of adding (or hold Shift)",
        flip(() => (minus = !minus)),
        "X",
      ),
      el("span", { class: "gap" }),
      ...back,
      el("span", { class: "gap" }),
      able("minus", "Smaller", "something smaller", () => larger(-1), "-", selected, nothing),
      able("plus", "Larger", "something larger", () => larger(1), "+", selected, nothing),
      able(
        "which",
        "Others",
        "what else may be meant",
        () => askWhich("Which one?"),
        "W",
        look && look.readings.length > 1,
        "there is one reading only",
      ),
      able(
        "invert",
        "Inverse",
        "all but this",
        () => change("step", ["invert", 0]),
        "I",
        selected,
        nothing,
      ),
      able(
        "keep",
        "Names",
        "keep what is marked by a name, or take it again",
        openNames,
        "N",
        s.draft.marks.length || s.draft.named.length,
        "mark something first",
      ),
    );
    if (focused >= 0) tools.children[focused]?.focus();
    box.dataset.tool = tool;
  }

  // ---- undo and redo: of marks, and where there are none of edits ----
  const marked = () => Boolean(s.draft.marks.length || s.draft.words);
  const canUndo = () => marked() || (s.isRun && !(s.fromRun && state() === scene));
  const canRedo = () => Boolean(s.draft.undone.length || undone.get(scene)?.length);
  function undo() {
    if (marked() || !canUndo()) return change("undo"); // the server may know of a mark that is on its way
    const one = s.history.find(({ name }) => name === state());
    undone.set(scene, [...(undone.get(scene) || []), state()]);
    go(sceneAddress(scene, (one && one.parent) || ""));
  }
  function redo() {
    const states = undone.get(scene);
    if (s.draft.undone.length || !states?.length) return change("redo");
    go(sceneAddress(scene, states.pop()));
  }
  const openNames = () =>
    !s.draft.marks.length && !s.draft.named.length
      ? toast("Mark something first; then it can be kept by a name.", true)
      : showNames(s.draft.named, s.draft.marks.length > 0, async (kind, name) => {
          await change(kind, name);
          return s.draft.named;
        });

  // ---- photos, scene, edit that is being made ----
  const thumbnails = () => `${s.state} ${s.photos} ${s.fixed} ${s.job ? s.preview : ""}`;
  function drawStrip() {
    strip.replaceChildren(
      ...s.photos.map((name, index) => {
        const source = s.byHand
          ? path("image", state(), "renders", name)
          : s.job
            ? s.preview.includes(name)
              ? path("image", state(), "preview", name)
              : path("thumbnail", scene, name)
            : path(s.isRun ? "photo" : "thumbnail", state(), name);
        const thumb = el(
          "button",
          {
            type: "button",
            class: "thumb",
            "aria-label": `photo ${index + 1}: ${name}`,
            title: `${name}${index < 9 ? ` (${index + 1})` : ""}`,
            onclick: () => showPhoto(index),
          },
          el("img", { src: source, alt: "" }),
          el("img", { class: "over", alt: "", "data-photo": name, hidden: true }),
        );
        const holder = el("div", { class: "thumb-holder" }, thumb);
        if (!s.fixed)
          holder.append(
            button("close", `take out ${name}`, () => takeOut(name), { class: "icon out" }),
          );
        return holder;
      }),
    );
    if (!s.fixed && !s.fromRun)
      strip.append(button("add", "add photos", () => choose(false, add), { class: "icon add" }));
    markThumb();
  }
  const markThumb = () =>
    [...strip.querySelectorAll(".thumb")].forEach((one, k) =>
      one.setAttribute("aria-current", String(k === photo)),
    );
  function showPhoto(index) {
    photo = index;
    markThumb();
    if (s.isRun && view === "3d") return post({ view: index });
    drawStage();
  }
  async function add(chosen, folder) {
    const { refused } = await send(chosen, scene, folder, busy);
    busy("");
    if (refused.length) toast(refused.slice(0, 5).join(" "), true);
    await refresh();
    await answer();
  }
  async function takeOut(name) {
    await attempt(() => tell(["remove", scene], { photo: name }));
    photo = 0;
    await refresh();
    await answer();
  }
  function drawStage() {
    const kind = s.isRun && view === "3d" ? "3d" : s.job ? "job" : "photo";
    document.body.dataset.view = kind;
    const wanted = kind === "3d" ? `3d ${state()} ${beside}` : kind;
    if (wanted !== shown) {
      shown = wanted;
      if (kind === "3d") stage.replaceChildren(...[state(), beside].filter(Boolean).map(viewer));
      else
        stage.replaceChildren(
          s.photos.length
            ? box
            : el(
                "p",
                { class: "empty" },
                "No photos yet: drop two or more of one scene anywhere here.",
              ),
        );
    }
    stage.classList.toggle("two", kind === "3d" && Boolean(beside));
    views.hidden = !s.isRun || s.byHand;
    compareButton.hidden = kind !== "3d";
    files.hidden = !s.isRun;
    objectsButton.hidden = !s.isRun;
    dock.inert = Boolean(s.job); // it keeps its place, so that nothing shifts
    if (kind !== "3d" && s.photos.length) {
      const name = current();
      const source =
        kind === "job"
          ? s.preview.includes(name)
            ? path("image", state(), "preview", name)
            : path("thumbnail", scene, name)
          : path("photo", state(), name);
      if (base.getAttribute("src") !== source) {
        base.src = source;
        base.alt = name;
        over.hidden = true;
      }
      const ours = strip.querySelector(`img.over[data-photo="${CSS.escape(name)}"]`);
      if (kind === "photo" && ours && !ours.hidden) {
        over.src = ours.src;
        over.hidden = false;
      }
      drawMarks();
    }
    views.replaceChildren(
      ...[
        ["photo", "Photos"],
        ["3d", "3D"],
      ].map(([key, text]) =>
        el(
          "button",
          {
            type: "button",
            "aria-pressed": String(view === key),
            onclick: () => {
              view = key;
              drawStage();
              drawTools();
              if (look) drawUnderstood();
            },
          },
          text,
        ),
      ),
    );
  }
  // The page of a run may come from a stranger: it is shown in a sandbox, and told things by messages.
  const viewer = (run) =>
    el("iframe", {
      src: `${path("viewer", run)}?embed`,
      sandbox: "allow-scripts allow-downloads",
      title: `the scene in 3D: ${run}`,
      onload: () => {
        post({
          compare: comparing && !beside && kept.drawer !== "objects",
          pointing: kept.drawer !== "objects",
          chosen: kept.drawer === "objects" ? kept.chosen : "",
          hidden: [...kept.hidden],
          ...(looked.scene === scene ? { camera: looked.camera } : {}),
        });
        post({ selected: [...tints.values()] });
      },
    });
  // A click on the scene is a mark on the photo that shows the place best.
  function pointed({ pointed: hit, minus: away }) {
    const known = hit && s.photos.includes(hit.name) && Array.isArray(hit.place);
    if (!known) return toast("No photo shows this place; point at it under Photos.", true);
    const kind = minus !== Boolean(away) ? "remove" : "add";
    photo = s.photos.indexOf(hit.name);
    markThumb();
    made({ kind, places: [hit.place.map(Number)] }, hit.name);
  }
  const frames = () => [...stage.querySelectorAll("iframe")];
  const post = (message, but = null) =>
    frames().forEach((one) => {
      if (one.contentWindow !== but) one.contentWindow.postMessage({ edit3r: message }, "*");
    });
  function compare(wanted) {
    comparing = wanted;
    compareButton.setAttribute("aria-pressed", String(wanted));
    post({ compare: wanted });
  }
  addEventListener(
    "message",
    (event) => {
      const frame = frames().find((one) => one.contentWindow === event.source),
        message = event.data && event.data.edit3r;
      if (!frame || !message) return;
      if (message.camera) {
        looked = { scene, camera: message.camera };
        if (beside) post({ camera: message.camera }, event.source);
      }
      if (message.pointed !== undefined) pointed(message);
      if (message.object) shape(message.object.action, message.object.name, message.object);
      if (typeof message.chosen === "string" && kept.drawer === "objects") choose3d(message.chosen);
      if (message.turn !== undefined)
        frame.replaceWith(
          Object.assign(viewer(state()), {
            src: `${path("viewer", state())}?embed#turn=${Number(message.turn)}`,
          }),
        );
      if (OF_PAGE.includes(message.key)) shortcut(message.key);
      if (message.undo !== undefined) message.undo ? undo() : redo();
    },
    on,
  );

  function drawPill() {
    const job = s.job,
      reading = s.reading;
    pill.classList.toggle("large", Boolean(job));
    if (job) {
      const line =
        job.state === "queued"
          ? "Waiting for the edit before it"
          : job.active
            ? `${stageWords(job.stage)}${job.left === null ? "" : ` · about ${seconds(job.left + 1)} left`}`
            : job.state === "cancelled"
              ? "Cancelled"
              : "It did not work";
      const act = job.active
        ? el(
            "button",
            {
              type: "button",
              onclick: (event) => {
                event.currentTarget.disabled = true;
                event.currentTarget.textContent = "Stopping";
                attempt(() => tell(["cancel", state()]));
              },
            },
            "Cancel",
          )
        : el(
            "button",
            {
              type: "button",
              class: "primary",
              onclick: () => go(sceneAddress(scene, job.parent)),
            },
            "Go back and change it",
          );
      if (pill.dataset.line !== line + job.state + job.share) {
        pill.dataset.line = line + job.state + job.share;
        pill.replaceChildren(
          el("strong", {}, job.prompt || "the scene as it is"),
          el("span", {}, line),
          job.active
            ? el("progress", {
                "aria-label": "share of this step",
                ...(job.share === null ? {} : { value: job.share, max: 1 }),
              })
            : el("span", { class: "problem" }, job.sentence),
          job.trouble ? el("span", { class: "problem" }, job.trouble) : "",
          act,
        );
      }
      pill.hidden = false;
      return;
    }
    const slow =
      view === "3d"
        ? ""
        : !reading.photos
          ? "Reading the photos"
          : !reading.geometry && s.photos.length > 1
            ? `Finding depth · about ${seconds(reading.left)} left; you can go on`
            : "";
    const line = lasting || working || slow;
    pill.hidden = !line;
    if (pill.dataset.line !== line) {
      pill.dataset.line = line;
      pill.replaceChildren(el("span", { class: "spin", "aria-hidden": "true" }), line);
    }
  }
  const STAGES = {
    "": "Starting",
    start: "Starting",
    "load components": "Loading",
    "read photos": "Reading the photos",
    "read scene": "Reading the scene",
    geometry: "Finding depth",
    select: "Finding the thing",
    edit: "Editing the photos",
    reconstruct: "Building the scene",
    check: "Looking at the result",
    render: "Drawing it",
    "write files": "Writing the files",
  };
  const stageWords = (name) => STAGES[name.replace(/ \(.*$/, "")] || "Polishing";
  let working = "",
    lasting = ""; // what no answer about marks ends
  function long(text) {
    lasting = text;
    if (s) drawPill();
  }
  function busy(text) {
    working = text;
    if (s) drawPill();
  }

  // ---- drawers and dialogs ----
  function toggleStrip() {
    const open = document.body.classList.toggle("no-strip");
    top.querySelector('[aria-label="photos"]').setAttribute("aria-expanded", String(!open));
  }
  function toggleDrawer(kind, open = kept.drawer !== kind) {
    kept.drawer = open ? kind : "";
    drawDrawer();
    post({ pointing: kept.drawer !== "objects" });
    post({ compare: comparing && !beside && kept.drawer !== "objects" });
    if (open) drawer.querySelector("button, a").focus();
  }
  function drawDrawer() {
    if (kept.drawer !== "history" && !s.isRun) kept.drawer = "";
    const kind = kept.drawer,
      close = () => toggleDrawer(kind, false);
    drawer.hidden = !kind;
    drawer.dataset.kind = kind;
    drawer.setAttribute("aria-label", { objects: "things", film: "a flight" }[kind] || "history");
    historyButton.setAttribute("aria-expanded", String(kind === "history"));
    objectsButton.setAttribute("aria-expanded", String(kind === "objects"));
    if (kind === "history") showHistory(drawer, s, close);
    if (kind === "film") drawFilm(close);
    if (kind !== "objects") return;
    if (!s.objects.includes(kept.chosen)) kept.chosen = "";
    const acts = {
      chosen: kept.chosen,
      hidden: kept.hidden,
      busy: shaping,
      ask: shape,
      choose: (name) => {
        kept.chosen = name;
        post({ chosen: name });
        drawDrawer();
      },
      hide: (name) => {
        if (!kept.hidden.delete(name)) kept.hidden.add(name);
        post({ hidden: [...kept.hidden] });
        drawDrawer();
      },
    };
    showObjects(drawer, s, acts, close);
  }
  // ---- a flight ----
  let filming = false;
  function drawFilm(close) {
    const changed = (keys) => {
      kept.keys = keys;
      drawDrawer();
    };
    showFilm(
      drawer,
      {
        keys: kept.keys,
        busy: filming,
        add: () => looked.camera && changed([...kept.keys, looked.camera]),
        look: (key) => post({ camera: key }),
        drop: (key) => changed(kept.keys.filter((one) => one !== key)),
        make: film,
      },
      close,
    );
  }
  async function film() {
    filming = true;
    drawDrawer();
    long("Drawing the flight");
    const keys = kept.keys.map(({ pose, K }) => ({ ...pose, K }));
    const bytes = await attempt(() => tell(["film", state()], { keys }));
    filming = false;
    long("");
    if (stop.signal.aborted) return;
    if (kept.drawer === "film") drawDrawer();
    if (!bytes) return;
    el("a", { href: path("download", state(), "flight.webm"), download: "" }).click();
    toast(`flight.webm is made: ${size(bytes)}.`);
  }
  const openPhone = () =>
    attempt(async () =>
      showPhone(await tell(["phone"], { page: location.pathname + location.search })),
    );

  function choose3d(name) {
    if (name === kept.chosen) return;
    kept.chosen = name;
    drawDrawer();
  }

  // ---- things: an action is a state of its own, so that it can be undone ----
  let shaping = false;
  async function shape(action, name, { numbers = [], text = "" } = {}) {
    if (shaping) return;
    shaping = true;
    if (kept.drawer) drawDrawer();
    long(action === "find" ? "Looking for things" : `${name}: ${ACTIONS[action] || action}`);
    const asked = { at, action, name, numbers, text };
    const job = await attempt(async () => {
      const made = await tell(["object", scene], asked);
      await finished(made);
      return made;
    });
    shaping = false;
    long("");
    if (stop.signal.aborted) return;
    if (!job) {
      for (const frame of frames()) frame.replaceWith(viewer(state())); // as it was
      if (kept.drawer) drawDrawer();
      return;
    }
    undone.delete(scene);
    if (action === "copy" || action === "rename") kept.chosen = text;
    if (action === "add") kept.chosen = name;
    go(sceneAddress(scene, job));
  }
  async function finished(job) {
    while (!stop.signal.aborted) {
      const found = await ask("scene", scene, { at: job });
      if (found.isRun) return;
      const is = found.job.state; // done: it ended while the server answered
      if (!found.job.active && is !== "done") throw new Error(found.job.sentence);
      await new Promise((done) => setTimeout(done, 300));
    }
  }
  const openSettings = () =>
    attempt(async () =>
      showSettings(
        await ask("settings", state()),
        (group, name, text) => change("set", [group, name, text]),
        () => ask("settings", state()),
      ),
    );
  const openFiles = () =>
    s.isRun
      ? attempt(async () =>
          showFiles(
            await ask("files", state()),
            state(),
            () => {
              view = "3d";
              drawStage();
              toggleDrawer("film", true);
            },
            openPhone,
          ),
        )
      : toast("There is nothing to take along yet: make an edit first.", true);
  function fullScreen() {
    const is = document.body.classList.toggle("only-scene");
    if (is && document.documentElement.requestFullscreen)
      document.documentElement.requestFullscreen().catch(() => {});
    else if (document.fullscreenElement) document.exitFullscreen();
  }

  function shortcut(key) {
    const acts = {
      p: () => take("point"),
      b: () => take("box"),
      r: () => take("brush"),
      l: () => take("lasso"),
      n: openNames,
      x: () => {
        minus = !minus;
        drawTools();
      },
      e: () => {
        exact = !exact;
        drawTools();
      },
      "+": () => larger(1),
      "=": () => larger(1),
      "-": () => larger(-1),
      i: () => change("step", ["invert", 0]),
      w: () => look && look.readings.length > 1 && askWhich("Which one?"),
      c: () => compare(!comparing),
      h: () => toggleDrawer("history"),
      o: () => s.isRun && toggleDrawer("objects"),
      d: openFiles,
      s: openSettings,
      v: toggleStrip,
      f: fullScreen,
      "?": () => showKeys(changeTheme),
      "/": () => said.focus(),
      m: () => s.isRun && !s.byHand && ((view = view === "3d" ? "photo" : "3d"), drawStage()),
    };
    if (acts[key]) acts[key]();
    else if (Number(key) && s.photos[key - 1]) showPhoto(key - 1);
    else return false;
    return true;
  }
  addEventListener(
    "keydown",
    (event) => {
      if (!s || document.querySelector("dialog[open]")) return;
      if (event.key === "Escape") {
        if (kept.drawer) toggleDrawer(kept.drawer, false);
        else if (document.body.classList.contains("only-scene")) fullScreen();
        question.hidden = true;
        return;
      }
      const typed = event.target.closest("input, textarea, select"),
        key = event.key.toLowerCase();
      if (typed) return;
      if (event.ctrlKey || event.metaKey) {
        if (key !== "z" && key !== "y") return;
        event.preventDefault();
        return void (key === "y" || event.shiftKey ? redo() : undo());
      }
      if (!event.altKey && shortcut(key)) event.preventDefault();
    },
    on,
  );
  let turned = 0;
  stage.addEventListener(
    "wheel",
    (event) => {
      // larger and smaller readings of what is selected
      if (document.body.dataset.view !== "photo" || event.ctrlKey) return;
      event.preventDefault();
      if (performance.now() - turned < 400 || !s.draft.selects) return;
      turned = performance.now();
      larger(event.deltaY < 0 ? 1 : -1);
    },
    { passive: false, ...on },
  );

  // ---- following the server ----
  let timer = 0;
  async function refresh() {
    clearTimeout(timer);
    try {
      const found = await ask("scene", scene, { at });
      if (stop.signal.aborted) return;
      const first = s === null,
        last = s;
      s = found;
      photo = Math.min(photo, Math.max(0, s.photos.length - 1));
      if (first) begin();
      if (last && last.job && s.isRun) view = "3d";
      if (first || thumbnails() !== refresh.drawn) {
        refresh.drawn = thumbnails();
        drawStrip();
        drawStage();
      } else if (last.isRun !== s.isRun) drawStage();
      drawPill();
      if (first || JSON.stringify(last.history) !== JSON.stringify(s.history)) drawDrawer();
      if (first || last.draft.version !== s.draft.version) {
        took(s.draft);
        if (!s.job && !s.byHand) answer();
      }
      if (last && last.job && s.isRun) said.value = s.draft.form.prompt || "";
    } catch (error) {
      if (stop.signal.aborted) return;
      if (s === null)
        stage.replaceChildren(
          el(
            "p",
            { class: "empty problem" },
            error.message,
            " ",
            el("a", { href: "/", "data-ours": true }, "All scenes"),
          ),
        );
      else {
        pill.hidden = false;
        pill.dataset.line = error.message;
        pill.replaceChildren(error.message);
      }
    }
    if (!stop.signal.aborted)
      timer = setTimeout(refresh, s && (s.job || !s.reading.geometry) ? 500 : 1500);
  }
  function begin() {
    dock.classList.remove("unready"); // shown when it keeps its place
    view = s.isRun ? "3d" : "photo";
    said.value = s.draft.form.prompt || "";
    if (s.isRun) said.placeholder = "And what next? Such as: make it blue";
    if (s.byHand) {
      // a sentence edits photos, and none shows what was changed by hand
      said.placeholder = "Changed by hand: say more in a state before it, or go on with Things";
      said.disabled = goButton.disabled = true;
    }
    drawTools();
    drawChip();
  }
  refresh();
  const undrop = dropAnywhere((chosen, folder) =>
    s && s.fixed
      ? toast("Edits were made from these photos; begin with new photos on the first page.", true)
      : add(chosen, folder),
  );
  return () => {
    stop.abort();
    clearTimeout(timer);
    clearTimeout(typing);
    resized.disconnect();
    undrop();
    document.body.classList.remove("no-strip", "only-scene");
    delete document.body.dataset.view;
  };
}
