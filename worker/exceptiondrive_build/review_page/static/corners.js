// The map from above, on which four corners are moved: x ahead is up, y left is left, in metres.
import { listed, shape } from "./ground.js";

const AROUND_M = 4;
const REACH_M = 120;
const GRID_M = 5;
const TURN_RAD = Math.PI / 90;
const HANDLE_PX = 8;
const FINGER_PX = 22;
const onMap = ([x, y]) => [-y, -x];
const offMap = (x, y) => [-y, -x];
const cm = (value) => Math.round(value * 100) / 100 + 0;

export class CornerEditor {
  corners = [];
  selected = 0; // 4: all of them
  #card = null;
  #steps = [];
  #box = [0, 0, 1, 1];

  constructor(svg, onChange) {
    this.svg = svg;
    this.onChange = onChange;
    new ResizeObserver(() => this.draw()).observe(svg);
    svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY / 400));
    }, { passive: false });
    svg.addEventListener("pointerdown", (event) => this.#down(event));
    svg.addEventListener("focusin", (event) => {
      const place = event.target.dataset?.place;
      if (place !== undefined) this.#select(Number(place));
    });
  }

  /** Take a card; `corners` if a decision was taken back. */
  take(card, corners = null) {
    this.#card = card;
    this.#steps = [];
    this.selected = 0;
    this.corners = (corners ?? card.corners).map(([x, y]) => [x, y]);
    const shown = [...this.corners, ...card.recorded, ...card.footprint,
      ...card.others.flatMap((word) => word.corners ?? [])].map(onMap);
    const low = [0, 1].map((axis) => Math.min(...shown.map((at) => at[axis])) - AROUND_M);
    const high = [0, 1].map((axis) => Math.max(...shown.map((at) => at[axis])) + AROUND_M);
    this.#box = [...low, high[0] - low[0], high[1] - low[1]];
    this.#changed();
  }

  /** Move the selected corner, or the whole region. */
  move(ahead, left) {
    this.#remember();
    this.corners = this.corners.map(([x, y], place) =>
      this.selected === 4 || this.selected === place ? [cm(x + ahead), cm(y + left)] : [x, y]);
    this.#changed();
  }

  /** Put one number in its place. */
  set(place, axis, value) {
    if (!Number.isFinite(value)) return;
    this.#remember();
    this.corners[place][axis] = value;
    this.#changed();
  }

  /** Turn the region about its middle. */
  turn(way) {
    this.#remember();
    const middle = [0, 1].map((axis) => this.corners.reduce((sum, at) => sum + at[axis], 0) / 4);
    const [cos, sin] = [Math.cos(way * TURN_RAD), Math.sin(way * TURN_RAD)];
    this.corners = this.corners.map(([x, y]) => {
      const [dx, dy] = [x - middle[0], y - middle[1]];
      return [cm(middle[0] + dx * cos - dy * sin), cm(middle[1] + dx * sin + dy * cos)];
    });
    this.#changed();
  }

  back() {
    const before = this.#steps.pop();
    if (before) {
      this.corners = before;
      this.#changed();
    }
  }

  proposal() {
    this.#remember();
    this.corners = this.#card.corners.map(([x, y]) => [x, y]);
    this.#changed();
  }

  selectNext() {
    this.#select((this.selected + 1) % 5);
  }

  zoom(factor) {
    const [left, top, width, height] = this.#box;
    const [w, h] = [width, height].map((size) => Math.min(Math.max(size * factor, 4), 2 * REACH_M));
    this.#box = [left + (width - w) / 2, top + (height - h) / 2, w, h];
    this.draw();
  }

  draw() {
    if (!this.#card) return;
    this.svg.setAttribute("viewBox", this.#box.join(" "));
    const metre = this.svg.getScreenCTM()?.a || 1;
    const focused = document.activeElement?.dataset?.place;
    const card = this.#card;
    this.svg.replaceChildren(
      ...grid(metre),
      shape("g", { class: "tube" }, ...card.tube.map((piece) => polygon("piece", piece))),
      polygon("car", card.footprint),
      polyline("path", [[0, 0], ...card.recorded]),
      ...card.recorded.map((at) => dot("stop", at, 3 / metre)),
      ...card.others.filter((word) => word.corners).map((word, place) =>
        polygon(`other other-${place + 1}`, word.corners)),
      polygon("safe", this.corners, { "stroke-width": 2 * card.d_safe_m }),
      polygon(this.selected === 4 ? "region all" : "region", this.corners),
      ...this.corners.map((at, place) => this.#handle(at, place, metre)),
    );
    if (focused !== undefined) this.svg.querySelector(`[data-place="${focused}"]`)?.focus();
  }

  #handle(at, place, metre) {
    const [x, y] = onMap(at);
    const kind = place === this.selected ? "handle on" : "handle";
    return shape("g", {
      class: kind, tabindex: 0, role: "button", "data-place": place,
      "aria-pressed": place === this.selected,
      "aria-label": `Corner ${place + 1}: ${at[0].toFixed(2)} m ahead, ${at[1].toFixed(2)} m left`,
    },
    shape("circle", { class: "finger", cx: x, cy: y, r: FINGER_PX / metre }),
    shape("circle", { cx: x, cy: y, r: HANDLE_PX / metre }),
    text("number", x, y, place + 1, 11 / metre));
  }

  #select(place) {
    if (this.selected === place) return;
    this.selected = place;
    this.draw();
  }

  #remember() {
    this.#steps.push(this.corners.map(([x, y]) => [x, y]));
  }

  #changed() {
    this.draw();
    this.onChange(this.corners);
  }

  #at(event) {
    const to = this.svg.getScreenCTM().inverse();
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(to);
    return [x, y];
  }

  #down(event) {
    const handle = event.target.closest("[data-place]");
    const isRegion = event.target.classList.contains("region");
    const from = this.#at(event);
    const before = this.corners.map(([x, y]) => [x, y]);
    const box = [...this.#box];
    if (handle) this.#select(Number(handle.dataset.place));
    else if (isRegion) this.#select(4);
    if (handle || isRegion) this.#remember();
    this.svg.setPointerCapture(event.pointerId);
    const moved = (move) => {
      if (move.pointerId !== event.pointerId) return;
      const at = this.#at(move);
      if (!handle && !isRegion) {
        this.#box = [this.#box[0] + from[0] - at[0], this.#box[1] + from[1] - at[1], box[2], box[3]];
        this.draw();
        return;
      }
      const [ahead, left] = offMap(at[0] - from[0], at[1] - from[1]);
      this.corners = before.map(([x, y], place) =>
        isRegion || place === this.selected ? [cm(x + ahead), cm(y + left)] : [x, y]);
      this.#changed();
    };
    const end = () => this.svg.removeEventListener("pointermove", moved);
    this.svg.addEventListener("pointermove", moved);
    this.svg.addEventListener("pointerup", end, { once: true });
    this.svg.addEventListener("pointercancel", end, { once: true });
  }
}

const polygon = (kind, points, more = {}) =>
  shape("polygon", { class: kind, points: listed(points.map(onMap)), ...more });
const polyline = (kind, points) =>
  shape("polyline", { class: kind, points: listed(points.map(onMap)) });
const dot = (kind, at, r) => {
  const [cx, cy] = onMap(at);
  return shape("circle", { class: kind, cx, cy, r });
};
const text = (kind, x, y, words, size) => shape("text",
  { class: kind, x, y, "font-size": size, "aria-hidden": true }, String(words).replace("-", "−"));

function* grid(metre) {
  const size = 11 / metre;
  for (let at = -REACH_M; at <= REACH_M; at += GRID_M) {
    yield shape("path", { class: at ? "grid" : "grid axis", d: `M${-REACH_M} ${at}H${REACH_M}` });
    yield shape("path", { class: at ? "grid" : "grid axis", d: `M${at} ${-REACH_M}V${REACH_M}` });
    yield text("tick", 0.2, at - 0.2, `${-at} m`, size);
    if (at) yield text("tick", at + 0.2, -0.2, `${-at} m`, size);
  }
}
