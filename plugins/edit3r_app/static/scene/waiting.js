// The pill over the stage: how far an edit is, or what somebody waits for.
import { go, sceneAddress } from "../address.js";
import { path, tell } from "../api.js";
import { el, seconds } from "../dom.js";
import { arriving } from "../upload.js";

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
const SILENT = 300; // [ms] that nothing need be said
const stageWords = (name) => STAGES[name.replace(/ \(.*$/, "")] || "Polishing";

export function waitingOf(page) {
  const pill = el("div", { class: "pill", role: "status", "aria-live": "polite", hidden: true });
  setTimeout(() => page.s || page.gone() || trouble("Opening the scene"), SILENT);
  let working = "",
    lasting = ""; // what no answer about marks ends
  function busy(text) {
    working = text;
    if (page.s) draw();
  }
  function long(text) {
    lasting = text;
    if (page.s && !page.gone()) draw();
  }
  function draw() {
    const { job } = page.s;
    pill.classList.toggle("large", Boolean(job));
    if (job) return drawJob(job);
    const line = lasting || working || slow();
    pill.hidden = !line;
    if (pill.dataset.line === line) return;
    pill.dataset.line = line;
    pill.replaceChildren(el("span", { class: "spin", "aria-hidden": "true" }), line);
  }
  const slow = () => {
    const { reading, photos } = page.s;
    if (arriving.has(page.scene)) return arriving.get(page.scene).line;
    if (page.view === "3d") return page.viewer.isDrawn() ? "" : "Drawing the scene";
    if (!reading.photos) return "Reading the photos";
    return !reading.geometry && photos.length > 1
      ? `Finding depth · about ${seconds(reading.left)} left; you can go on`
      : "";
  };

  const lineOf = (job) =>
    job.state === "queued"
      ? "Waiting for the edit before it"
      : job.active
        ? `${stageWords(job.stage)}${job.left === null ? "" : ` · about ${seconds(job.left + 1)} left`}`
        : job.state === "cancelled"
          ? "Cancelled"
          : "This did not work";
  const cancel = (event) => {
    event.currentTarget.disabled = true;
    event.currentTarget.textContent = "Stopping";
    page.attempt(() => tell(["cancel", page.state()]));
  };
  const actOf = (job) =>
    job.active
      ? el("button", { type: "button", onclick: cancel }, "Cancel")
      : el(
          "button",
          {
            type: "button",
            class: "primary",
            onclick: () => go(sceneAddress(page.scene, job.parent)),
          },
          "Go back and change it",
        );
  function drawJob(job) {
    const line = lineOf(job),
      key = line + job.state + job.share;
    pill.hidden = false;
    if (pill.dataset.line === key) return;
    pill.dataset.line = key;
    pill.replaceChildren(
      el("strong", {}, job.prompt || "the scene as it is"),
      el("span", {}, line),
      job.active
        ? el("progress", {
            "aria-label": "share of this edit",
            ...(job.share === null ? {} : { value: job.share, max: 1 }),
          })
        : el("span", { class: "problem" }, job.sentence),
      job.trouble ? el("span", { class: "problem" }, job.trouble) : "",
      !job.active && job.kept
        ? el(
            "a",
            { href: path("download", page.state(), "edited-photos.zip"), download: "" },
            "Download the edited photos",
          )
        : "",
      actOf(job),
    );
  }
  // What keeps the page from following the server.
  function trouble(text) {
    pill.hidden = false;
    pill.dataset.line = text;
    pill.replaceChildren(text);
  }
  return { node: pill, busy, long, draw, trouble };
}
