// Verifying regions: corners moved on the map, projected into every view as they move.
import { CornerEditor } from "./corners.js";
import { CardQueue, ask } from "./queue.js";

const find = (id) => document.getElementById(id);
const PAUSE_MS = 80;
const STEP_M = 0.1;
const ARROWS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };
const KINDS = {
  physical: "Is the region the space that the hazard takes?",
  conflict: "Is the region the no-go area: where the car must not be?",
};
const boxes = [...document.querySelectorAll("[name=checked]")];
const fields = [...document.querySelectorAll("[data-corner]")];
let timer = 0;

const editor = new CornerEditor(find("map"), (corners) => {
  for (const field of fields) {
    const value = corners[field.dataset.corner][field.dataset.axis];
    if (document.activeElement !== field) field.value = value.toFixed(2);
  }
  cards.pictures.draw();
  clearTimeout(timer);
  timer = setTimeout(measure, PAUSE_MS);
});

const page = {
  show(card, value) {
    for (const box of boxes) box.checked = value?.checked?.includes(box.value) ?? false;
    find("kind").textContent = KINDS[card.task.region];
    find("third").hidden = find("l-others").hidden = !card.third;
    find("others").replaceChildren(...card.others.map((word) => {
      const said = word.accepted ? "accepted this region" : `rejected it: ${word.reason ?? "no reason"}`;
      const item = document.createElement("li");
      item.textContent = [said, word.checked.length ? `checked ${word.checked.join(", ")}` : "",
        word.note].filter(Boolean).join(" · ");
      return item;
    }));
    cards.pictures.show(card, () => [
      ["path", [[0, 0], ...card.recorded], false],
      ...card.others.filter((word) => word.corners)
        .map((word, place) => [`other other-${place + 1}`, word.corners, true]),
      ["region", editor.corners, true],
    ]);
    find("numbers").textContent = "";
    editor.take(card, value?.corners);
  },

  value(accepted, reason) {
    const checked = boxes.filter((box) => box.checked).map((box) => box.value);
    if (accepted && !checked.length) {
      const keys = boxes.map((box) => box.dataset.key).join(", ");
      cards.notice(`Say what you checked: X for all of it, or ${keys}.`);
      return null;
    }
    return {
      accepted, checked, reason, corners: accepted ? editor.corners : null,
      note: find("note").value.trim(), blind: !cards.card.third,
    };
  },

  key({ key: pressed, shiftKey, altKey }) {
    const arrow = ARROWS[pressed];
    const key = pressed.toLowerCase(); // caps lock may be on
    const step = STEP_M * (shiftKey ? 10 : altKey ? 0.1 : 1);
    const box = boxes.find((one) => one.dataset.key.toLowerCase() === key);
    if (arrow) editor.move(arrow[0] * step, arrow[1] * step);
    else if (key === "[" || key === "]") editor.turn(key === "[" ? 1 : -1);
    else if (key === "c") editor.selectNext();
    else if (key === "z") editor.back();
    else if (key === "p") editor.proposal();
    else if (key === "x") for (const box of boxes) box.checked = true;
    else if (box) box.checked = !box.checked;
    else return false;
    return true;
  },
};

/** Ask the geometry that scores: area, the recorded drive's clearance, what a split would refuse. */
async function measure() {
  const { card } = cards;
  if (!card) return;
  const value = { accepted: true, corners: editor.corners };
  const answer = await ask("verify/measure", { card: card.id, value }).catch(() => null);
  if (!answer?.ok || cards.card !== card) return;
  const { area_m2: area, clearance_m: clearance, faults } = answer.body;
  const words = [];
  if (area !== null) words.push(`${area.toFixed(2)} m²`);
  if (clearance !== null) {
    words.push(clearance === 0 ? "the recorded drive meets it"
      : `the recorded drive passes at ${clearance.toFixed(2)} m`);
  }
  words.push(`d_safe ${card.d_safe_m.toFixed(1)} m`);
  if (card.source === "by_hand") words.push("no detector’s proposal: drawn at the target");
  find("numbers").textContent = [words.join(" · "), ...faults].join(". Cannot be scored: ");
  find("numbers").classList.toggle("problem", faults.length > 0);
}

for (const field of fields) {
  field.addEventListener("input", () =>
    editor.set(Number(field.dataset.corner), Number(field.dataset.axis), field.valueAsNumber));
}
find("back").addEventListener("click", () => editor.back());
find("proposal").addEventListener("click", () => editor.proposal());
find("map-in").addEventListener("click", () => editor.zoom(1 / 1.4));
find("map-out").addEventListener("click", () => editor.zoom(1.4));
const cards = new CardQueue(page);
