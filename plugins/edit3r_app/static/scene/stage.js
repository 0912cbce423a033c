// What fills the page: the scene in 3D, the photo, or the photo while an edit is being made.
import { path } from "../api.js";
import { el } from "../dom.js";

export const has3d = (s) => s.isRun || s.isSplat; // whether there is a scene to turn

// `parts`: what is shown with one of them only, {stage, views, files, objects, dock}.
export function stageOf(page, { stage, views, files, objects, dock }) {
  let shown = "";
  function draw() {
    const { s } = page;
    const kind = has3d(s) && page.view === "3d" ? "3d" : s.job ? "job" : "photo";
    document.body.dataset.view = kind;
    page.verdicts.draw();
    page.adjust.draw(false);
    fill(kind);
    stage.classList.toggle("two", kind === "3d" && Boolean(page.beside));
    views.hidden = !has3d(s) || s.byHand;
    files.hidden = !s.isRun;
    objects.hidden = !s.isRun;
    dock.inert = Boolean(s.job); // it keeps its place, so that nothing shifts
    if (kind !== "3d" && s.photos.length) drawPhoto(kind);
    drawViews();
  }
  function fill(kind) {
    // while an edit is made the scene before it stays
    const before = kind === "job" ? page.s.job.parent : "";
    const wanted = kind === "3d" ? `3d ${page.state()} ${page.beside}` : `${kind} ${before}`;
    if (wanted === shown) return;
    shown = wanted;
    if (before) return page.viewer.show([before]);
    if (kind === "3d") {
      page.viewer.show([page.state(), page.beside].filter(Boolean));
      for (const name of page.s.photos) {
        const known = page.strip.over(name); // what was selected before, on the photos
        if (known) page.viewer.tint(name, known);
      }
      return;
    }
    stage.replaceChildren(
      page.s.photos.length
        ? page.picture.box
        : el(
            "p",
            { class: "empty" },
            "No photos yet: drop two or more of one scene anywhere here.",
          ),
    );
  }
  function drawPhoto(kind) {
    const name = page.current();
    const source =
      kind === "job"
        ? page.s.preview.includes(name)
          ? path("image", page.state(), "preview", name)
          : path("thumbnail", page.scene, name)
        : `${path("photo", page.state(), name)}?shown`; // which will be pointed at
    page.picture.show(name, source, kind === "photo" && page.strip.over(name));
  }
  const drawViews = () =>
    views.replaceChildren(
      ...[
        ["photo", page.s.isSplat ? "Pictures" : "Photos"],
        ["3d", "3D"],
      ].map(([key, text]) =>
        el(
          "button",
          {
            type: "button",
            "aria-pressed": String(page.view === key),
            onclick: () => {
              page.view = key;
              draw();
              page.tools.draw();
              if (page.look) page.bar.drawUnderstood();
            },
          },
          text,
        ),
      ),
    );
  return { draw };
}

export function fullScreen() {
  const is = document.body.classList.toggle("only-scene");
  if (is && document.documentElement.requestFullscreen)
    document.documentElement.requestFullscreen().catch(() => {});
  else if (document.fullscreenElement) document.exitFullscreen();
}
