// The parts of the page that work without asking the server: sending files, marking by pointer.

async function edit3rSend(files, scene, folder) {
  const refused = [];
  for (const [index, file] of [...files].entries()) {
    emitEvent("edit3r_sending", { done: index, total: files.length });
    const headers = { "X-Name": encodeURIComponent(file.name), "X-Folder": encodeURIComponent(folder || "") };
    let sentence = file.name + ": could not be sent; is the app still running?";
    try {
      const answer = await fetch("/upload/" + encodeURIComponent(scene || "-"), { method: "POST", body: file, headers });
      const text = await answer.text();
      if (answer.ok) [scene, sentence] = [text, ""];
      else sentence = answer.status == 413 ? file.name + ": " + text : text;
    } catch (error) {} // the sentence is there
    if (sentence) refused.push(sentence);
  }
  emitEvent("edit3r_sent", { scene: scene || "", refused: refused.slice(0, 300) });
}

// Photos of dropped things; a folder stands for all that is in it.
async function edit3rDropped(items) {
  const entries = [...items].map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry()).filter((entry) => entry);
  const files = [];
  const walk = async (entry) => {
    if (entry.isFile) return files.push(await new Promise((done, failed) => entry.file(done, failed)));
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((done, failed) => reader.readEntries(done, failed));
      if (!some.length) return;
      for (const one of some) await walk(one);
    }
  };
  for (const entry of entries) await walk(entry);
  files.sort((a, b) => a.name.localeCompare(b.name, undefined, { numeric: true }));
  const folder = entries.length == 1 && entries[0].isDirectory ? entries[0].name : "";
  return [folder ? files.filter((file) => /\.(jpe?g|jpe|jfif|mpo|png|webp|tiff?|hei[cf]|avif|bmp|p[pg]m|jp2)$/i.test(file.name)) : files, folder];
}

function edit3rChoose(scene, folder) {
  const input = Object.assign(document.createElement("input"), { type: "file", multiple: true });
  if (folder) input.webkitdirectory = true;
  input.onchange = () => {
    const name = folder && input.files.length ? input.files[0].webkitRelativePath.split("/")[0] : "";
    const files = [...input.files].filter((file) => !folder || /^image\//.test(file.type) || /\.hei[cf]$/i.test(file.name));
    edit3rSend(files.sort((a, b) => a.name.localeCompare(b.name, undefined, { numeric: true })), scene, name);
  };
  input.click();
}

for (const kind of ["dragover", "dragleave", "drop"])
  document.addEventListener(kind, async (event) => {
    event.preventDefault(); // a photo beside the field would otherwise open in the tab
    const zone = document.querySelector(".e3-drop");
    if (!zone) return;
    zone.classList.toggle("e3-over", kind == "dragover");
    if (kind != "drop" || !event.dataTransfer.items.length) return;
    const [files, folder] = await edit3rDropped(event.dataTransfer.items);
    edit3rSend(files, zone.dataset.scene, folder);
  });

// A click, in the mode "box" a drag, in the modes of the brush a stroke, on a photo; places are x and y in [0, 1] of it.
let edit3rDrag = null;
const edit3rPlace = (event, image) => {
  const area = image.getBoundingClientRect();
  const inside = (value) => Math.min(1, Math.max(0, value));
  return [inside((event.clientX - area.left) / area.width), inside((event.clientY - area.top) / area.height)];
};
document.addEventListener("pointerdown", (event) => {
  const image = event.target.closest("img.e3-mark");
  if (!image || event.button) return;
  const [box, brush] = [".e3-box", ".e3-brush"].map((mode) => image.closest(mode));
  edit3rDrag = { image, places: [edit3rPlace(event, image)], box: !!box, brush: !!brush };
  if (box) edit3rDrag.shown = image.parentElement.appendChild(Object.assign(document.createElement("div"), { className: "e3-rect" }));
  if (!brush) return;
  const { width, height } = image.getBoundingClientRect();
  const shown = Object.assign(document.createElement("canvas"), { className: "e3-stroke", width, height });
  const pen = Object.assign(shown.getContext("2d"), { lineWidth: brush.dataset.brush * Math.max(width, height), lineCap: "round", lineJoin: "round", strokeStyle: "#ff408c99" });
  Object.assign(edit3rDrag, { shown: image.parentElement.appendChild(shown), pen });
  edit3rStroke();
});
document.addEventListener("pointermove", (event) => {
  if (!edit3rDrag || !edit3rDrag.shown) return;
  const { image, places, shown, brush } = edit3rDrag;
  const [u, v] = edit3rPlace(event, image);
  if (brush) {
    const [x, y] = places[places.length - 1];
    if (Math.hypot(u - x, v - y) < 0.008) return;
    places.push([u, v]);
    return edit3rStroke();
  }
  const [x, y] = places[0];
  const [left, top, width, height] = [Math.min(x, u), Math.min(y, v), Math.abs(u - x), Math.abs(v - y)].map((value) => 100 * value + "%");
  Object.assign(shown.style, { left, top, width, height });
});
document.addEventListener("pointercancel", () => edit3rEnd());
document.addEventListener("pointerup", (event) => {
  if (!edit3rDrag) return;
  const { image, places, box, brush } = edit3rDrag;
  places.push(edit3rPlace(event, image));
  edit3rEnd();
  const [[x, y], [u, v]] = [places[0], places[places.length - 1]];
  const moved = Math.hypot(u - x, v - y) > 0.02;
  if (moved && !box && !brush) return; // scrolled
  emitEvent("edit3r_mark", { view: Number(image.dataset.view), places, box: box && moved, remove: event.altKey });
});
function edit3rStroke() {
  const { pen, places, shown } = edit3rDrag;
  pen.clearRect(0, 0, shown.width, shown.height);
  pen.beginPath();
  for (const [x, y] of places.concat(places.slice(-1))) pen.lineTo(x * shown.width, y * shown.height);
  pen.stroke();
}
function edit3rEnd() {
  if (edit3rDrag && edit3rDrag.shown) edit3rDrag.shown.remove();
  edit3rDrag = null;
}
