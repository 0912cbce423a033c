// Photos from the disk, from a drop, or from a phone's camera to the server, one after the other.
import { path } from "./api.js";

const PHOTO = /\.(jpe?g|jpe|jfif|mpo|png|webp|tiff?|hei[cf]|avif|bmp|p[pg]m|jp2)$/i;
const inOrder = (files) =>
  [...files].sort((a, b) => a.name.localeCompare(b.name, undefined, { numeric: true }));

// By scene: how far its photos are that are still being sent, and a promise of all of them.
export const arriving = new Map();

// Returns the scene and the sentences about what was refused; `told` hears how far it is, and `begun`
// which scene it is as soon as its first photo is there.
export async function send(files, scene, folder, told, begun = () => {}) {
  const refused = [];
  let done;
  const all = new Promise((resolve) => (done = resolve));
  for (const [index, file] of [...files].entries()) {
    const line = `Sending ${index + 1} of ${files.length}: ${file.name}`;
    told(line);
    if (scene) arriving.set(scene, { line, all });
    const headers = {
      "X-Name": encodeURIComponent(file.name),
      "X-Folder": encodeURIComponent(folder || ""),
    };
    try {
      const answer = await fetch(path("upload", scene || "-"), {
        method: "POST",
        body: file,
        headers,
      });
      const text = await answer.text();
      if (answer.ok && !scene) begun(text);
      if (answer.ok) scene = text;
      else refused.push(answer.status === 413 ? `${file.name}: ${text}` : text);
    } catch {
      refused.push(`${file.name}: could not be sent; is the app still running?`);
    }
  }
  arriving.delete(scene);
  done();
  return { scene: scene || "", refused };
}

// Files of dropped things, and the folder's name; a folder stands for all photos in it.
export async function dropped(items) {
  const entries = [...items]
    .map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry())
    .filter(Boolean);
  const files = [];
  const walk = async (entry) => {
    if (entry.isFile)
      return void files.push(await new Promise((done, failed) => entry.file(done, failed)));
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((done, failed) => reader.readEntries(done, failed));
      if (!some.length) return;
      for (const one of some) await walk(one);
    }
  };
  for (const entry of entries) await walk(entry);
  const folder = entries.length === 1 && entries[0].isDirectory ? entries[0].name : "";
  return [inOrder(folder ? files.filter((file) => PHOTO.test(file.name)) : files), folder];
}

// Ask for files, or for a folder of them.
export function choose(isFolder, chosen) {
  // Without HEIC in the list, phones send JPEG instead.
  const accept = "image/jpeg,image/png,image/webp,image/tiff,image/avif,video/*,.ply,.spz,.sog,.splat,.ksplat,.glb";
  const input = Object.assign(document.createElement("input"), {
    type: "file",
    multiple: true,
    accept,
  });
  if (isFolder) input.webkitdirectory = true;
  input.onchange = () => {
    const name =
      isFolder && input.files.length ? input.files[0].webkitRelativePath.split("/")[0] : "";
    chosen(
      inOrder(isFolder ? [...input.files].filter((file) => PHOTO.test(file.name)) : input.files),
      name,
    );
  };
  input.click();
}

// What is dropped anywhere on the page goes to `chosen`; a photo would otherwise open in the tab.
export function dropAnywhere(chosen) {
  const over = (event) => {
    event.preventDefault();
    document.body.classList.toggle("dropping", event.type === "dragover");
  };
  const drop = async (event) => {
    over(event);
    if (event.dataTransfer.items.length) chosen(...(await dropped(event.dataTransfer.items)));
  };
  const stop = new AbortController();
  for (const kind of ["dragover", "dragleave"])
    document.addEventListener(kind, over, { signal: stop.signal });
  document.addEventListener("drop", drop, { signal: stop.signal });
  return () => stop.abort();
}
