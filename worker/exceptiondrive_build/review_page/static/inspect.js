// Inspecting edits: marks, measured change, and why the card is here.
import { spoken } from "./pictures.js";
import { CardQueue } from "./queue.js";

const find = (id) => document.getElementById(id);
const PAN_PX = 60;
const ARROWS = {
  ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
};

const page = {
  show(card) {
    const facts = [["Here by", card.why]];
    for (const [mark, value] of Object.entries(card.marks)) {
      facts.push([mark.replaceAll("_", " "), `${value} of 5`]);
    }
    for (const view of card.views.filter((one) => one.change)) {
      const inside = view.change.inside === null ? "target not in view"
        : `${percent(view.change.inside)} in the target area`;
      facts.push([`changed, ${spoken(view.name)}`,
        `${inside}, ${percent(view.change.outside)} outside`]);
    }
    if (card.review_note) facts.push(["The model says", card.review_note]);
    find("facts").replaceChildren(...facts.map(([name, value]) => {
      const row = document.createElement("div");
      row.append(Object.assign(document.createElement("dt"), { textContent: name }));
      row.append(Object.assign(document.createElement("dd"), { textContent: value }));
      return row;
    }));
    cards.pictures.show(card);
  },

  value(passed, reason) {
    return { passed, reason, note: find("note").value.trim() };
  },

  key({ key }) {
    const arrow = ARROWS[key];
    if (!arrow) return false;
    if (cards.pictures.isZoomed) cards.pictures.pan(arrow[0] * PAN_PX, arrow[1] * PAN_PX);
    else cards.pictures.step(-(arrow[0] + arrow[1]));
    return true;
  },
};

const percent = (share) => `${(share * 100).toFixed(0)} %`;
const cards = new CardQueue(page);
