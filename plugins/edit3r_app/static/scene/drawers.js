// What opens beside the scene: history, things, a flight; and the dialogs of settings and downloads.
import { ROOT } from "../address.js";
import { ask, path, tell } from "../api.js";
import { button, el, size, toast } from "../dom.js";
import { showFilm } from "../film.js";
import { showObjects } from "../objects.js";
import { PLAYS_MP4, showFiles, showHistory, showPhone, showSettings } from "../panels.js";

const TITLES = { history: "history", objects: "things", film: "a flight" };

export function drawersOf(page) {
  const { kept } = page;
  const node = el("aside", { class: "drawer", hidden: true });
  const opener = (icon, label, kind, key, more = {}) =>
    button(icon, label, () => toggle(kind), { key, "aria-expanded": "false", ...more });
  const historyButton = opener("history", "history", "history", "H");
  const objectsButton = opener("things", "things", "objects", "O", { hidden: true });

  function toggle(kind, open = kept.drawer !== kind) {
    kept.drawer = open ? kind : "";
    draw();
    page.viewer.followDrawer();
    if (open) node.querySelector("button, a").focus();
  }
  function draw() {
    if (kept.drawer !== "history" && !page.s.isRun) kept.drawer = "";
    const kind = kept.drawer,
      close = () => toggle(kind, false);
    node.hidden = !kind;
    node.dataset.kind = kind;
    node.setAttribute("aria-label", TITLES[kind] || "history");
    historyButton.setAttribute("aria-expanded", String(kind === "history"));
    objectsButton.setAttribute("aria-expanded", String(kind === "objects"));
    if (kind === "history") showHistory(node, page.s, close);
    if (kind === "film") drawFilm(close);
    if (kind === "objects") drawObjects(close);
  }

  // ---- things ----
  let takes = false; // whether what is marked can be taken as a thing
  function drawObjects(close) {
    takes = marks();
    if (!page.s.objects.includes(kept.chosen)) kept.chosen = "";
    const acts = {
      chosen: kept.chosen,
      hidden: kept.hidden,
      busy: page.things.isBusy(),
      takes,
      ask: page.things.shape,
      choose: (name) => {
        kept.chosen = name;
        page.viewer.post({ chosen: name });
        draw();
      },
      hide: (name) => {
        if (!kept.hidden.delete(name)) kept.hidden.add(name);
        page.viewer.post({ hidden: [...kept.hidden] });
        draw();
      },
    };
    showObjects(node, page.s, acts, close);
  }
  const marks = () => page.s.draft.selects || page.sculpt.has();
  const followMarks = () => kept.drawer === "objects" && marks() !== takes && draw();
  // What was chosen in the scene itself.
  function choose(name) {
    if (name === kept.chosen) return;
    kept.chosen = name;
    draw();
  }

  // ---- a flight ----
  let filming = false;
  function drawFilm(close) {
    const changed = (keys) => {
      kept.keys = keys;
      draw();
    };
    const acts = {
      keys: kept.keys,
      busy: filming,
      add: () => page.viewer.camera() && changed([...kept.keys, page.viewer.camera()]),
      look: (key) => page.viewer.post({ camera: key }),
      drop: (key) => changed(kept.keys.filter((one) => one !== key)),
      make: film,
    };
    showFilm(node, acts, close);
  }
  async function film() {
    filming = true;
    draw();
    page.waiting.long("Drawing the flight");
    const keys = kept.keys.map(({ pose, K }) => ({ ...pose, K }));
    const made = await page.attempt(() => tell(["film", page.state()], { keys, mp4: PLAYS_MP4 }));
    filming = false;
    page.waiting.long("");
    if (page.gone()) return;
    if (kept.drawer === "film") draw();
    if (!made) return;
    el("a", { href: path("download", page.state(), made.file), download: "" }).click();
    toast(`${made.file} is made: ${size(made.bytes)}.`);
  }

  // ---- dialogs ----
  async function opening(work) {
    page.waiting.busy("Opening it");
    await page.attempt(work);
    page.waiting.busy("");
  }
  const openPhone = () =>
    opening(async () =>
      showPhone(await tell(["phone"], { page: `/${location.pathname.slice(ROOT.length)}${location.search}` })),
    );
  const openSettings = () =>
    opening(async () =>
      showSettings(
        await ask("settings", page.state()),
        (group, name, text) => page.draft.change("set", [group, name, text]),
        () => ask("settings", page.state()),
      ),
    );
  const openFilm = () => {
    page.view = "3d";
    page.stage.draw();
    toggle("film", true);
  };
  const openFiles = () =>
    page.s.isRun
      ? opening(async () =>
          showFiles(await ask("files", page.state()), page.state(), openFilm, openPhone),
        )
      : toast("There is nothing to download yet: make an edit first.", true);
  return {
    node,
    historyButton,
    objectsButton,
    toggle,
    draw,
    choose,
    followMarks,
    openSettings,
    openFiles,
  };
}
