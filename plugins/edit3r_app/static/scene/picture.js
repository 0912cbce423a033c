// One photo in full, what is selected on it, and pointing at it.
import { path, tell } from "../api.js";
import { el } from "../dom.js";
import { pointing } from "../pointing.js";


// How wide an image is, once it is there; 0 where it is none.
export const imageThere = (address) =>
  new Promise((done) => {
    const one = new Image();
    one.onload = () => done(one.naturalWidth);
    one.onerror = () => done(0);
    one.src = address;
  });

// `stage` is the room that the photo fills.
export function pictureOf(page, stage) {
  const layer = (name, more) => el("img", { class: name, alt: "", draggable: "false", ...more });
  const base = layer("base"),
    edit = layer("edit", { hidden: true }),
    over = layer("over", { hidden: true }),
    hover = layer("over", { hidden: true });
  // A ring where a mark was made, until its outline is there.
  const ring = el("span", { class: "heard", hidden: true });
  const box = el(
    "div",
    {
      class: "box unready",
      tabindex: "0",
      role: "application",
      "aria-label": "the photo; arrow keys move a cross, Enter points at it",
    },
    base,
    edit,
    over,
    hover,
    ring,
  );
  const tool = () => ({
    kind: page.tool,
    minus: page.minus,
    exact: page.exact,
    radius: page.brush,
  });
  const marks = pointing(box, tool, made, rests);
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

  function hear(mark) {
    ring.hidden = !mark;
    if (!mark) return void page.viewer.post({ heard: false });
    [ring.style.left, ring.style.top] = mark.places.at(-1).map((share) => `${100 * share}%`);
  }
  let hovered = 0,
    pressed = 0;
  const pointedAt = (mark, name, more = "") =>
    `${path("pointed", page.state(), name)}?v=${page.s.draft.version}${more}&mark=${encodeURIComponent(JSON.stringify({ ...mark, photo: name }))}`;
  async function rests(mark) {
    const number = ++hovered;
    if (!mark) return void (hover.hidden = true);
    if (!page.s || !page.s.reading.photos) return;
    const address = pointedAt(mark, page.current());
    if (!(await imageThere(address)) || number !== hovered) return;
    hover.src = address;
    hover.hidden = false;
  }
  // What a mark would take of a photo, for the scene in 3D; null where somebody points elsewhere meanwhile.
  async function meant(mark, name) {
    const number = ++hovered;
    if (!mark || !page.s.reading.photos) return null;
    const address = pointedAt(mark, name, "&made=1");
    return (await imageThere(address)) && number === hovered ? address : null;
  }
  async function made(mark, name = page.current()) {
    hovered++;
    page.question.close();
    pressed = performance.now();
    if (page.view === "photo") hear(mark);
    page.waiting.busy(
      page.s.reading.photos ? "Looking for what you mean" : "Reading the photos first",
    );
    const before = page.s.draft.marks.concat({ ...mark, photo: name });
    marks.show(before.filter((one) => one.photo === page.current()));
    // The photo that was clicked is answered first, while the mark is written; then all the others.
    const address = pointedAt(mark, name, "&made=1");
    const seen = imageThere(address).then((there) => {
      if (there && pressed) setOver(name, address); // else the full answer was there first
      hover.hidden = true;
    });
    const draft = await page.attempt(() =>
      tell(["draft", page.state()], { do: "mark", value: { ...mark, photo: name } }),
    );
    if (!draft) return void (hear(null), drawMarks());
    page.draft.took(draft);
    await seen;
    await page.draft.answer();
  }
  const drawMarks = () =>
    marks.show(page.s.draft.marks.filter((one) => one.photo === page.current()));
  // What is selected on the photo `name`: in the strip, in 3D, and here where it is shown.
  function setOver(name, address) {
    page.strip.setOver(name, address);
    if (page.view === "3d") page.viewer.tint(name, address);
    if (name === page.current()) {
      lay(address);
      over.hidden = page.view !== "photo";
    } else if (page.view !== "3d") return;
    ring.hidden = true; // in 3D the tint ends it
    if (pressed) document.body.dataset.outlined = Math.round(performance.now() - pressed); // [ms], for those who measure
    pressed = 0;
  }
  // Where the edit is shown nothing is darker: the outline alone lies over it.
  let laid = "";
  function lay(address) {
    laid = address;
    over.src = edit.hidden ? address : `${address}&line=1`;
  }
  // The 2D edit of the photo that is shown, as soon as words and marks allow one; `found`: the thing
  // is known on all photos.
  let previewing = 0;
  async function preview(found = false) {
    const number = ++previewing,
      { draft, job, byHand } = page.s;
    if (page.view !== "photo" || job || byHand) return;
    if (!draft.form.prompt || page.adjust.isOff()) return setEdit("");
    const address = `${path("edited", page.state(), page.current())}?v=${draft.version}${found ? "&found=1" : ""}`;
    const width = await imageThere(address);
    if (number === previewing && !page.gone()) setEdit(width > 1 ? address : "");
  }
  function setEdit(address) {
    if (!address) previewing++;
    const was = edit.hidden;
    edit.hidden = !address;
    if (address) edit.src = address;
    if (was !== edit.hidden && laid) lay(laid);
    page.adjust.draw(Boolean(address));
    if (!address || !page.typed) return;
    document.body.dataset.previewed = Math.round(performance.now() - page.typed); // [ms], for those who measure
    page.typed = 0;
  }
  // Show the photo `name` from `source`; `selected` lies over it where it is known.
  function show(name, source, selected) {
    if (base.getAttribute("src") !== source) {
      base.src = source;
      base.alt = name;
      over.hidden = ring.hidden = edit.hidden = true;
      laid = "";
    }
    if (selected) {
      lay(selected);
      over.hidden = false;
    }
    drawMarks();
    preview(Boolean(page.look));
  }
  return { box, show, made, meant, drawMarks, setOver, preview, setEdit, leave: () => resized.disconnect() };
}
