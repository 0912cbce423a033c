// The scene in 3D. The page of a run may come from a stranger: it is shown in a sandbox, and told things by messages.
import { go, sceneAddress } from "../address.js";
import { path } from "../api.js";
import { button, el, toast } from "../dom.js";

const OF_PAGE = ["escape", "f", "h", "i", "k", "l", "m", "n", "o", "v", "x", "/", "?", "[", "]"]; // keys that 3D leaves to the page
const UNTOLD = 5000; // [ms]
const ERASER = 0.015; // radius of a line that takes away, of the photo's longer side
let looked = { scene: "", camera: null }; // where a scene was looked at last: its other states are seen from there

export function viewerOf(page, stage) {
  const { scene, beside, kept } = page;
  let drawn = false;
  const ofThings = () => kept.drawer === "objects";
  const compares = () => kept.compares && !beside && !["objects", "film"].includes(kept.drawer);
  const frame = (run) =>
    el("iframe", {
      src: `${path("viewer", run)}?embed`,
      sandbox: "allow-scripts allow-downloads",
      title: `the scene in 3D: ${run}`,
      onload: () => {
        post({
          compare: compares(),
          pointing: !ofThings(),
          chosen: ofThings() ? kept.chosen : "",
          hidden: [...kept.hidden],
          ...(looked.scene === scene ? { camera: looked.camera } : {}),
        });
        post({ selected: [...tints.values()] });
        page.sculpt.restore();
        page.ruler.ask();
        setTimeout(seen, UNTOLD); // pages of older runs do not tell
      },
    });
  function seen() {
    drawn = true;
    if (page.s && !page.gone()) page.waiting.draw();
  }
  const frames = () => [...stage.querySelectorAll("iframe")];
  const post = (message, but = null) =>
    frames().forEach((one) => {
      if (one.contentWindow !== but) one.contentWindow.postMessage({ edit3r: message }, "*");
    });

  // What is selected on the photos is tinted in 3D: the viewer hears which of their pixels it covers.
  const tints = new Map();
  async function covered(name, address) {
    const image = new Image();
    image.src = address;
    await image.decode().catch(() => {});
    const { naturalWidth: width, naturalHeight: height } = image;
    if (width < 2) return null;
    const canvas = new OffscreenCanvas(width, height),
      ink = canvas.getContext("2d");
    ink.drawImage(image, 0, 0);
    const { data } = ink.getImageData(0, 0, width, height);
    const inside = Uint8Array.from({ length: width * height }, (_, k) => Number(!data[4 * k + 3]));
    return { name, width, height, inside };
  }
  async function tint(name, address) {
    const mask = await covered(name, address);
    if (mask) tints.set(name, mask);
    else tints.delete(name);
    post({ selected: [...tints.values()] });
  }
  // A place, or places along a line, that the scene found on a photo: a mark there; null for what is none.
  function markOf(hit, away) {
    const found = hit && (hit.places || [hit.place]); // pages of older runs tell one
    if (!hit || !page.s.photos.includes(hit.name) || !Array.isArray(found[0])) return null;
    const minus = page.minus !== Boolean(away),
      places = found.map((place) => place.map(Number));
    if (places.length < 2) return { kind: minus ? "remove" : "add", places };
    return minus ? { kind: "erase", places, radius: ERASER } : { kind: "stroke", places };
  }
  // A click on the scene is a mark on the photo that shows the place best.
  function pointed({ pointed: hit, minus }) {
    const mark = markOf(hit, minus);
    if (!mark) {
      post({ heard: false });
      return toast("No photo shows this place; point at it under Photos.", true);
    }
    page.photo = page.s.photos.indexOf(hit.name);
    page.strip.mark();
    page.picture.made(mark, hit.name);
  }
  // What a click would take is tinted where the mouse rests.
  async function rested({ rests: hit, minus }) {
    const address = await page.picture.meant(markOf(hit, minus), hit && hit.name);
    if (address) post({ meant: await covered(hit.name, address) });
  }
  const compare = () => post({ compare: compares() });
  addEventListener(
    "message",
    (event) => {
      const from = frames().find((one) => one.contentWindow === event.source),
        message = event.data && event.data.edit3r;
      if (!from || !message) return;
      if (message.camera) {
        looked = { scene, camera: message.camera };
        if (beside) post({ camera: message.camera }, event.source);
      }
      if (message.drawn) seen();
      if (message.stroke) page.sculpt.stroke(message.stroke, message.minus);
      if (message.measured) page.ruler.measured(message.measured);
      if (message.pointed !== undefined) pointed(message);
      if (message.rests !== undefined) rested(message);
      if (message.object)
        page.things.shape(message.object.action, message.object.name, message.object);
      if (typeof message.chosen === "string" && ofThings()) page.drawers.choose(message.chosen);
      if (message.turn !== undefined)
        from.replaceWith(
          Object.assign(frame(page.state()), {
            src: `${path("viewer", page.state())}?embed#turn=${Number(message.turn)}`,
          }),
        );
      if (OF_PAGE.includes(message.key)) page.keys.press(message.key);
      if (message.undo !== undefined) message.undo ? page.draft.undo() : page.draft.redo();
    },
    page.on,
  );
  // Two edits say which they are, and each can be left.
  const titled = (run, k, runs) =>
    el(
      "div",
      { class: "one" },
      frame(run),
      el(
        "p",
        {},
        page.s.history.find(({ name }) => name === run)?.prompt || run,
        button("close", "leave this one", () => go(sceneAddress(scene, runs[1 - k]))),
      ),
    );
  return {
    compare,
    isDrawn: () => drawn,
    show: (runs) => {
      drawn = false;
      stage.replaceChildren(...(runs.length > 1 ? runs.map(titled) : runs.map(frame)));
    },
    again: () => frames().forEach((one) => one.replaceWith(frame(page.state()))), // as it was
    camera: () => looked.camera,
    followDrawer: () => {
      post({ pointing: !ofThings() });
      compare();
    },
    post,
    tint,
  };
}
