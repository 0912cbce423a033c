// Marks on a photo, by mouse, finger or keys; places are x and y in [0, 1] of the photo.

const SVG = "http://www.w3.org/2000/svg";
const MOVED = 0.012; // share of the photo from which a press is a drag
const STEP = 0.02; // of the arrow keys
const node = (tag, values) => {
  const made = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(values)) made.setAttribute(key, value);
  return made;
};

// `tool()` says how is marked now: {kind: point | box | brush | lasso, minus, exact, radius}; `done(mark)` takes what was made,
// and `rests(mark)` hears where a mouse rests, null where it left.
export function pointing(box, tool, done, rests) {
  const drawing = node("svg", { class: "marks", "aria-hidden": "true" });
  box.append(drawing);
  let drag = null,
    cursor = null,
    waiting = 0,
    shownMarks = [];

  const place = (event) => {
    const area = box.getBoundingClientRect(),
      inside = (value) => Math.min(1, Math.max(0, value));
    return [
      inside((event.clientX - area.left) / area.width),
      inside((event.clientY - area.top) / area.height),
    ];
  };
  const far = ([x, y], [u, v]) => Math.hypot(x - u, y - v);

  function markOf(places, { kind, minus, exact, radius }) {
    const dragged = places.length > 1 && far(places[0], places.at(-1)) > MOVED;
    if (kind === "box" && dragged)
      return { kind: exact ? "exact" : "box", places: [places[0], places.at(-1)] };
    if (kind === "brush")
      return { kind: minus ? "erase" : "paint", places: [...places, places.at(-1)], radius };
    const long = places.some((one) => far(one, places[0]) > MOVED);
    if (kind === "lasso" && long) return { kind: minus ? "carve" : "lasso", places };
    if (long && minus) return { kind: "erase", places, radius: 0.015 };
    return long
      ? { kind: "stroke", places }
      : { kind: minus ? "remove" : "add", places: [places[0]] };
  }
  const now = (event) => {
    const set = tool();
    return { ...set, minus: set.minus !== Boolean(event.shiftKey) };
  };

  box.addEventListener("pointerdown", (event) => {
    if (event.button || !event.isPrimary) return;
    box.setPointerCapture(event.pointerId);
    drag = { places: [place(event)], set: now(event) };
    clearTimeout(waiting);
    // a press is asked about before it ends: most are clicks
    rests(drag.set.kind === "point" ? markOf(drag.places, drag.set) : null);
    draw();
  });
  box.addEventListener("pointermove", (event) => {
    if (!drag) return rest(event);
    const at = place(event);
    if (drag.set.kind === "box") drag.places[1] = at;
    else if (far(at, drag.places.at(-1)) > 0.006) drag.places.push(at);
    if (drag.places.length > 1) rests(null);
    draw();
  });
  box.addEventListener("pointerup", () => {
    if (!drag) return;
    const mark = markOf(drag.places, drag.set);
    drag = null;
    draw();
    done(mark);
  });
  box.addEventListener("pointercancel", () => {
    drag = null;
    draw();
  });
  box.addEventListener("pointerleave", () => {
    clearTimeout(waiting);
    rests(null);
  });
  function rest(event) {
    // what a click would take is shown where the mouse rests
    if (event.pointerType !== "mouse" || tool().kind !== "point") return;
    clearTimeout(waiting);
    rests(null);
    const mark = markOf([place(event)], now(event));
    waiting = setTimeout(() => rests(mark), 110);
  }

  box.addEventListener("keydown", (event) => {
    const way = {
      ArrowLeft: [-STEP, 0],
      ArrowRight: [STEP, 0],
      ArrowUp: [0, -STEP],
      ArrowDown: [0, STEP],
    }[event.key];
    if (way) {
      cursor = (cursor || [0.5, 0.5]).map((value, k) => Math.min(1, Math.max(0, value + way[k])));
      rests(markOf([cursor], now(event)));
    } else if (event.key === "Enter" && cursor)
      done(markOf([cursor], { ...now(event), kind: "point" }));
    else return;
    event.preventDefault();
    draw();
  });
  box.addEventListener("blur", () => {
    cursor = null;
    draw();
  });

  function draw() {
    const width = box.clientWidth,
      height = box.clientHeight,
      at = ([x, y]) => [x * width, y * height];
    drawing.setAttribute("viewBox", `0 0 ${width} ${height}`);
    drawing.replaceChildren();
    for (const { kind, places } of shownMarks) {
      const [x, y] = at(places[0]),
        [u, v] = at(places.at(-1));
      if (kind === "box" || kind === "exact") drawing.append(rectangle(x, y, u, v));
      else if (kind === "add" || kind === "remove")
        drawing.append(node("circle", { cx: x, cy: y, r: 7, class: kind }));
    }
    if (drag) {
      const mark = markOf(drag.places, drag.set),
        points = mark.places.map(at);
      const width2 = mark.radius ? 2 * mark.radius * Math.max(width, height) : 5;
      if (mark.kind === "box" || mark.kind === "exact")
        drawing.append(rectangle(...points[0], ...points.at(-1)));
      else if (points.length > 1)
        drawing.append(
          node(mark.kind === "lasso" || mark.kind === "carve" ? "polygon" : "polyline", {
            points: points.join(" "),
            "stroke-width": width2,
            class: mark.kind,
          }),
        );
      else
        drawing.append(
          node("circle", { cx: points[0][0], cy: points[0][1], r: 7, class: mark.kind }),
        );
    }
    if (cursor) {
      const [x, y] = at(cursor);
      drawing.append(node("path", { d: `M${x - 14} ${y}h28M${x} ${y - 14}v28`, class: "cursor" }));
    }
  }
  const rectangle = (x, y, u, v) =>
    node("rect", {
      x: Math.min(x, u),
      y: Math.min(y, v),
      width: Math.abs(u - x),
      height: Math.abs(v - y),
    });
  return {
    show: (marks) => {
      shownMarks = marks;
      draw();
    },
    draw,
  };
}
