// The scene in 3D. The page of a run may come from a stranger: it is shown in a sandbox, and told things by messages.
import { path } from "../api.js";
import { button, el, toast } from "../dom.js";

const OF_PAGE = ["f", "h", "i", "l", "m", "n", "o", "v", "x", "/", "?"]; // keys that 3D leaves to the page
let looked = { scene: "", camera: null }; // where a scene was looked at last: its other states are seen from there

export function viewerOf(page, stage) {
  const { scene, beside, kept } = page;
  let comparing = true;
  const compareButton = button("compare", "before and after", () => compare(!comparing), {
    key: "C",
  });
  const ofThings = () => kept.drawer === "objects";
  const compares = () => comparing && !beside && !ofThings();
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
      },
    });
  const frames = () => [...stage.querySelectorAll("iframe")];
  const post = (message, but = null) =>
    frames().forEach((one) => {
      if (one.contentWindow !== but) one.contentWindow.postMessage({ edit3r: message }, "*");
    });

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
  // A click on the scene is a mark on the photo that shows the place best.
  function pointed({ pointed: hit, minus: away }) {
    const known = hit && page.s.photos.includes(hit.name) && Array.isArray(hit.place);
    if (!known) return toast("No photo shows this place; point at it under Photos.", true);
    const kind = page.minus !== Boolean(away) ? "remove" : "add";
    page.photo = page.s.photos.indexOf(hit.name);
    page.strip.mark();
    page.picture.made({ kind, places: [hit.place.map(Number)] }, hit.name);
  }
  function compare(wanted) {
    comparing = wanted;
    compareButton.setAttribute("aria-pressed", String(wanted));
    post({ compare: wanted });
  }
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
      if (message.pointed !== undefined) pointed(message);
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
  return {
    compareButton,
    toggleCompare: () => compare(!comparing),
    show: (runs) => stage.replaceChildren(...runs.map(frame)),
    again: () => frames().forEach((one) => one.replaceWith(frame(page.state()))), // as it was
    camera: () => looked.camera,
    followDrawer: () => {
      post({ pointing: !ofThings() });
      post({ compare: compares() });
    },
    post,
    tint,
  };
}
