// The photos of a scene in a row: one is chosen, some are added or taken out.
import { path, tell } from "../api.js";
import { button, dialog, el, toast } from "../dom.js";
import { choose, dropAnywhere, send } from "../upload.js";

export function stripOf(page, strip) {
  const { scene } = page;
  const source = (name) =>
    page.s.byHand
      ? path("image", page.state(), "renders", name)
      : page.s.job
        ? page.s.preview.includes(name)
          ? path("image", page.state(), "preview", name)
          : path("thumbnail", scene, name)
        : path(page.s.isRun ? "photo" : "thumbnail", page.state(), name);
  function holder(name, index) {
    const thumb = el(
      "button",
      {
        type: "button",
        class: "thumb",
        "aria-label": `photo ${index + 1}: ${name}`,
        title: `${name}${index < 9 ? ` (${index + 1})` : ""}`,
        onclick: () => show(index),
      },
      el("img", { src: source(name), alt: "" }),
      el("img", { class: "over", alt: "", "data-photo": name, hidden: true }),
    );
    const out = () =>
      button("close", `take out ${name}`, () => takeOut(name), { class: "icon out" });
    return el("div", { class: "thumb-holder" }, thumb, !page.s.fixed && out());
  }
  function draw() {
    const { s } = page;
    strip.replaceChildren(...s.photos.map(holder));
    if (s.isSplat && !s.isRun && !s.history.length)
      strip.prepend(button("upright", "which way is up", askUp, { text: "up", class: "icon tool add" }));
    if (!s.fixed && !s.fromRun)
      strip.append(button("add", "add photos", () => choose(false, add), { class: "icon add" }));
    mark();
  }
  function askUp() {
    const axis = (up) => el("button", { type: "button", onclick: () => turn(up) }, up.toUpperCase());
    const turn = async (up) => {
      asked.close();
      page.waiting.long("Turning the scene");
      if ((await page.attempt(() => tell(["upright", scene], { up }))) !== null) location.reload();
    };
    const asked = dialog(
      "Which way is up?",
      el("p", {}, "If the scene lies on its side or on its head, choose the axis that points up in its file. Marks on it are forgotten."),
      el("div", { class: "row" }, ["-y", "+y", "+z", "-z", "+x", "-x"].map(axis)),
    );
  }
  const mark = () =>
    [...strip.querySelectorAll(".thumb")].forEach((one, k) =>
      one.setAttribute("aria-current", String(k === page.photo)),
    );
  function show(index) {
    page.photo = index;
    mark();
    if (page.view === "3d") return page.viewer.post({ view: index });
    page.stage.draw();
  }
  async function add(chosen, folder) {
    const { refused } = await send(chosen, scene, folder, page.waiting.long);
    page.waiting.long("");
    if (refused.length) toast(refused.slice(0, 5).join(" "), true);
    await page.refresh();
    await page.draft.answer();
  }
  async function takeOut(name) {
    await page.attempt(() => tell(["remove", scene], { photo: name }));
    page.photo = 0;
    await page.refresh();
    await page.draft.answer();
  }
  const undrop = dropAnywhere((chosen, folder) =>
    page.s && page.s.fixed
      ? toast("This scene takes no more photos; begin with new ones on the first page.", true)
      : add(chosen, folder),
  );

  function setOver(name, address) {
    for (const image of strip.querySelectorAll("img.over"))
      if (image.dataset.photo === name) {
        image.src = address;
        image.hidden = false;
      }
  }
  // The address of what is selected on a photo, where it is known.
  function over(name) {
    const ours = strip.querySelector(`img.over[data-photo="${CSS.escape(name)}"]`);
    return ours && !ours.hidden && ours.src;
  }
  return { draw, mark, show, add, setOver, over, leave: undrop };
}
