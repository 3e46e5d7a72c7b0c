// Where the ground stands in a picture. `ground` takes (x, y, 1) in metres to (u depth, v depth, depth).
const NEAR_M = 0.3;

const seen = (ground, [x, y]) => ground.map(([a, b, c]) => a * x + b * y + c);
const pixel = ([u, v, depth]) => [u / depth, v / depth];
const cut = (here, there) => {
  const share = (NEAR_M - here[2]) / (there[2] - here[2]);
  return here.map((value, axis) => value + (there[axis] - value) * share);
};

/** The part of a polygon (or, `closed` false, of a line) in front of a camera, in pixels. */
export function project(ground, points, closed = true) {
  const all = points.map((point) => seen(ground, point));
  const found = [];
  all.forEach((here, place) => {
    if (here[2] >= NEAR_M) found.push(pixel(here));
    if (!closed && place === all.length - 1) return;
    const there = all[(place + 1) % all.length];
    if ((here[2] >= NEAR_M) !== (there[2] >= NEAR_M)) found.push(pixel(cut(here, there)));
  });
  return found;
}

/** Points as SVG writes them. */
export const listed = (points) => points.map(([x, y]) => `${x.toFixed(2)},${y.toFixed(2)}`).join(" ");

/** An SVG element with attributes. */
export function shape(name, attributes, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}
