// All views of a card: source and edited in one place, flipped, swiped and zoomed together.
import { listed, project, shape } from "./ground.js";

const SLOP_PX = 8;
const MOST = 12;
const find = (id) => document.getElementById(id);

export class Pictures {
  #focus = find("focus");
  #both = this.#focus.querySelector(".both");
  #thumbs = find("thumbs");
  #place = 0;
  #views = [];
  #drawn = () => [];
  #fingers = new Map();
  #zoom = { scale: 1, x: 0, y: 0 };

  constructor() {
    const flip = find("flip");
    flip.addEventListener("pointerdown", () => this.flip(true));
    for (const end of ["pointerup", "pointerleave", "pointercancel"]) {
      flip.addEventListener(end, () => this.flip(false));
    }
    find("swipe").addEventListener("input", (event) => this.#swipe(event.target.value));
    find("zoom-in").addEventListener("click", () => this.zoomBy(1.5));
    find("zoom-out").addEventListener("click", () => this.zoomBy(1 / 1.5));
    find("zoom-off").addEventListener("click", () => this.zoomOff());
    this.#focus.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoomBy(Math.exp(-event.deltaY / 300), this.#at(event));
    }, { passive: false });
    this.#focus.addEventListener("pointerdown", (event) => this.#down(event));
    this.#focus.addEventListener("pointermove", (event) => this.#moved(event));
    for (const end of ["pointerup", "pointercancel"]) {
      this.#focus.addEventListener(end, (event) => {
        this.#fingers.delete(event.pointerId);
        this.flip(false);
      });
    }
  }

  /** Show a card; `drawn` gives what lies on the ground: [class, points, closed]. */
  show(card, drawn = () => []) {
    this.#views = card.views;
    this.#drawn = drawn;
    this.flip(false);
    this.#swipe(100);
    this.zoomOff();
    this.#thumbs.replaceChildren(...card.views.map((view, place) => this.#thumb(view, place)));
    const off = card.views.map((view) => aside(view, card.target));
    this.look(off.indexOf(Math.min(...off)));
  }

  /** Bring a view to the front. */
  look(place) {
    if (!this.#views[place]) return;
    this.#place = place;
    const view = this.#views[place];
    fill(this.#both, view);
    this.#focus.style.setProperty("--ratio", `${view.width} / ${view.height}`);
    find("view-name").textContent = spoken(view.name);
    [...this.#thumbs.children].forEach((thumb, at) =>
      thumb.setAttribute("aria-pressed", String(at === place)));
    this.#say();
    this.draw();
  }

  /** Whether source and edited picture of every edited view can be seen. */
  areThere() {
    const images = [...this.#thumbs.querySelectorAll(".is-edited img")];
    return images.every((image) => image.complete && image.naturalWidth > 0);
  }

  /** Look at the view so many places on. */
  step(by) {
    this.look((this.#place + by + this.#views.length) % this.#views.length);
  }

  /** Draw what lies on the ground anew, into every view. */
  draw() {
    const shapes = this.#drawn();
    const draw = (svg, view) => svg.replaceChildren(...shapes.map(([kind, points, closed]) =>
      shape(closed ? "polygon" : "polyline", {
        class: kind, points: listed(project(view.ground, points, closed)),
      })));
    draw(this.#both.querySelector("svg"), this.#views[this.#place]);
    [...this.#thumbs.children].forEach((thumb, place) =>
      draw(thumb.querySelector("svg"), this.#views[place]));
  }

  /** Source in place of edited, while it is held. */
  flip(isSource) {
    document.body.classList.toggle("flipped", isSource);
    this.#say();
  }

  /** Swipe on by a quarter, and round. */
  swipeOn() {
    const now = Number(find("swipe").value);
    this.#swipe(now === 0 ? 100 : Math.max(now - 25, 0));
  }

  get isZoomed() {
    return this.#zoom.scale > 1;
  }

  /** Move the enlarged picture by pixels. */
  pan(x, y) {
    this.#zoom.x += x;
    this.#zoom.y += y;
    this.#apply();
  }

  /** Enlarge around a point of the frame. */
  zoomBy(factor, at = null) {
    const { scale, x, y } = this.#zoom;
    const next = Math.min(Math.max(scale * factor, 1), MOST);
    const [px, py] = at ?? [this.#focus.clientWidth / 2, this.#focus.clientHeight / 2];
    this.#zoom = {
      scale: next, x: px - ((px - x) * next) / scale, y: py - ((py - y) * next) / scale,
    };
    this.#apply();
  }

  zoomOff() {
    this.#zoom = { scale: 1, x: 0, y: 0 };
    this.#apply();
  }

  #apply() {
    const { scale } = this.#zoom;
    const { clientWidth: width, clientHeight: height } = this.#focus;
    this.#zoom.x = Math.min(0, Math.max(this.#zoom.x, width * (1 - scale)));
    this.#zoom.y = Math.min(0, Math.max(this.#zoom.y, height * (1 - scale)));
    this.#both.style.transform = `translate(${this.#zoom.x}px,${this.#zoom.y}px) scale(${scale})`;
    this.#focus.classList.toggle("zoomed", scale > 1);
  }

  #swipe(share) {
    find("swipe").value = share;
    document.documentElement.style.setProperty("--swipe", `${100 - share}%`);
    this.#say();
  }

  #say() {
    const view = this.#views[this.#place];
    if (!view) return;
    const isSource = document.body.classList.contains("flipped");
    const share = Number(find("swipe").value);
    const words = !view.edited ? "not edited"
      : isSource || share === 0 ? "source"
      : share === 100 ? "edited" : "edited | source";
    find("shown").textContent = words;
    find("shown").dataset.shown = words;
  }

  #thumb(view, place) {
    const thumb = document.createElement("button");
    thumb.className = "thumb";
    thumb.innerHTML = '<span class="both"><img class="source" alt=""><img class="edited" alt="">'
      + '<svg class="over" aria-hidden="true"></svg></span><span class="name"></span>';
    fill(thumb.querySelector(".both"), view);
    thumb.querySelector(".name").textContent = `${place + 1} ${spoken(view.name)}`;
    if (view.edited) thumb.classList.add("is-edited");
    thumb.addEventListener("click", () => this.look(place));
    return thumb;
  }

  #at(event) {
    const box = this.#focus.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  #down(event) {
    this.#focus.setPointerCapture(event.pointerId);
    this.#fingers.set(event.pointerId, { at: this.#at(event), from: this.#at(event) });
    this.flip(this.#fingers.size === 1);
  }

  #moved(event) {
    const finger = this.#fingers.get(event.pointerId);
    if (!finger) return;
    const at = this.#at(event);
    if (this.#fingers.size === 2) {
      const other = [...this.#fingers].find(([id]) => id !== event.pointerId)[1].at;
      const apart = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
      const middle = [(at[0] + other[0]) / 2, (at[1] + other[1]) / 2];
      this.zoomBy(apart(at) / Math.max(apart(finger.at), 1), middle);
    } else if (this.isZoomed) {
      const far = Math.hypot(at[0] - finger.from[0], at[1] - finger.from[1]);
      if (far > SLOP_PX) this.flip(false);
      this.pan(at[0] - finger.at[0], at[1] - finger.at[1]);
    }
    finger.at = at;
  }
}

/** Fetch the pictures of cards that are not on the screen yet. */
export function prefetch(cards) {
  return cards.flatMap((card) => card.views.flatMap((view) =>
    [view.source, view.edited].filter(Boolean).map((name) => {
      const image = new Image();
      image.src = address(name);
      return image;
    })));
}

export const spoken = (name) =>
  name.replace(/^CAM_/, "").replaceAll("_", " ").toLowerCase();
const address = (name) => `/pictures/${name}`;

/** How far from the middle of a picture the target stands; edited views come first. */
function aside(view, target) {
  const [at] = target ? project(view.ground, [target], false) : [];
  const far = at ? Math.abs(at[0] / view.width - 0.5) : 1e3;
  return view.edited ? far : far + 1e6;
}

function fill(both, view) {
  const [source, edited] = both.querySelectorAll("img");
  source.src = address(view.source);
  edited.hidden = !view.edited;
  if (view.edited) edited.src = address(view.edited);
  else edited.removeAttribute("src");
  both.querySelector("svg").setAttribute(
    "viewBox", `-0.5 -0.5 ${view.width} ${view.height}`); // (0, 0) is the centre of a pixel
}
