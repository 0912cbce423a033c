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
  // Without HEIC in the list, phones send JPEG instead.
  const accept = "image/jpeg,image/png,image/webp,image/tiff,image/avif,video/*";
  const input = Object.assign(document.createElement("input"), { type: "file", multiple: true, accept });
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

// ---- marks: a click, a dragged box, or a stroke of the brush; places are x and y in [0, 1] of the photo ----

let edit3rDrag = null;
const edit3rPlace = (event, image) => {
  const area = image.getBoundingClientRect();
  const inside = (value) => Math.min(1, Math.max(0, value));
  return [inside((event.clientX - area.left) / area.width), inside((event.clientY - area.top) / area.height)];
};
document.addEventListener("pointerdown", (event) => {
  const image = event.target.closest("img.e3-mark");
  if (!image || event.button) return;
  const { mode, radius } = image.closest(".e3-photos").dataset;
  const kind = mode == "add" && event.altKey ? "remove" : mode;
  const mark = { kind, photo: image.alt, places: [edit3rPlace(event, image)], radius: Number(radius || 0.04) };
  edit3rDrag = { image, mark, drawn: null };
  edit3rDrawDrag();
});
document.addEventListener("pointermove", (event) => {
  if (!edit3rDrag || !edit3rDrag.drawn) return;
  const { image, mark } = edit3rDrag;
  const place = edit3rPlace(event, image), last = mark.places[mark.places.length - 1];
  if (mark.kind == "box") mark.places[1] = place;
  else if (Math.hypot(place[0] - last[0], place[1] - last[1]) > 0.008) mark.places.push(place);
  edit3rDrawDrag();
});
document.addEventListener("pointercancel", () => edit3rEnd());
document.addEventListener("pointerup", (event) => {
  if (!edit3rDrag) return;
  const { image, mark } = edit3rDrag;
  edit3rEnd();
  const end = edit3rPlace(event, image), [x, y] = mark.places[0];
  const moved = Math.hypot(end[0] - x, end[1] - y) > 0.02;
  if (mark.kind == "box" && !moved) mark.kind = event.altKey ? "remove" : "add";
  if (moved && ["add", "remove"].includes(mark.kind)) return; // scrolled
  if (mark.kind == "box") mark.places = [mark.places[0], end];
  else if (mark.places.length > 1 || moved) mark.places.push(end);
  emitEvent("edit3r_mark", mark);
});
function edit3rDrawDrag() {
  const { image, mark, drawn } = edit3rDrag;
  if (["add", "remove"].includes(mark.kind)) return;
  if (drawn) drawn.remove();
  edit3rDrag.drawn = edit3rDraw(image, [mark], true);
}
function edit3rEnd() {
  if (edit3rDrag && edit3rDrag.drawn) edit3rDrag.drawn.remove();
  edit3rDrag = null;
}

// Draw marks over a photo; strokes only while they are made, since afterwards the outline shows them.
function edit3rDraw(image, marks, strokes) {
  const [width, height] = [image.clientWidth, image.clientHeight], at = ([x, y]) => [x * width, y * height];
  const node = (tag, values) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [key, value] of Object.entries(values)) made.setAttribute(key, value);
    return made;
  };
  const over = node("svg", { viewBox: `0 0 ${width} ${height}`, class: "e3-over-photo" });
  for (const { kind, places, radius } of marks) {
    const all = places.concat(places.slice(-1)).map(at), [x, y] = all[0], [u, v] = all[all.length - 1];
    if (kind == "box") over.append(node("rect", { x: Math.min(x, u), y: Math.min(y, v), width: Math.abs(u - x), height: Math.abs(v - y), "stroke-width": 2 }));
    else if (kind == "add" || kind == "remove") over.append(node("circle", { cx: x, cy: y, r: 7, "stroke-width": 2, class: "e3-" + kind }));
    else if (strokes) over.append(node("polyline", { points: all.join(" "), "stroke-width": 2 * radius * Math.max(width, height), class: "e3-" + kind }));
  }
  image.parentElement.append(over);
  return over;
}
function edit3rDrawAll() {
  const grid = document.querySelector(".e3-photos[data-marks]");
  if (!grid) return;
  const { marks } = JSON.parse(grid.dataset.marks);
  for (const old of grid.querySelectorAll(".e3-over-photo")) old.remove();
  for (const image of grid.querySelectorAll("img.e3-mark")) edit3rDraw(image, marks.filter((mark) => mark.photo == image.alt), false);
  if (edit3rDrag && edit3rDrag.drawn) edit3rDrawDrag(); // a stroke may be under way while an outline arrives
}
document.addEventListener("load", (event) => event.target.matches && event.target.matches("img.e3-mark") && edit3rDrawAll(), true);
addEventListener("resize", edit3rDrawAll);

// ---- keys, outside of fields where one types ----

addEventListener("keydown", (event) => {
  if (event.target.closest("input, textarea")) return;
  if ((event.ctrlKey || event.metaKey) && event.key == "z") {
    event.preventDefault();
    emitEvent("edit3r_undo");
  } else if (["+", "-"].includes(event.key) && !event.ctrlKey && !event.metaKey) {
    emitEvent("edit3r_step", event.key == "+" ? "larger" : "smaller");
  }
});

// ---- two scenes beside each other: a camera that moves in one moves in the other ----

addEventListener("message", (event) => {
  const frames = [...document.querySelectorAll(".e3-two iframe")].map((frame) => frame.contentWindow);
  if (!frames.includes(event.source) || !event.data || !event.data.edit3rCamera) return;
  for (const frame of frames) if (frame != event.source) frame.postMessage(event.data, "*");
});
