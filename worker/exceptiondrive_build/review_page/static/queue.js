// Cards one after the other: claimed ahead, decided, undone; how far and how long still.
import { Pictures, prefetch } from "./pictures.js";

const { queue, leaseS, tab } = document.body.dataset;
const find = (id) => document.getElementById(id);
const AWAKE_S = 60; // a longer pause is no work
const ASK_AGAIN_MS = 3000;
const ONCE = /^([arsu1-9]|Enter)$/i; // a key that is held decides one card
const UNANSWERED = "The review server does not answer. Your decision is still here; try again.";

export class CardQueue {
  #held = [];
  #ahead = [];
  #paces = [];
  #shownAt = 0;
  #isBusy = false;
  #isChoosing = false;
  #asked = Promise.resolve();

  /** `page` has show(card, value), value(isAccepted, reason) -> word or null, key(event) -> taken. */
  constructor(page) {
    this.page = page;
    this.pictures = new Pictures();
    find("accept").addEventListener("click", () => this.decide(true));
    find("reject").addEventListener("click", () => this.#choose(!this.#isChoosing));
    find("skip").addEventListener("click", () => this.#skip());
    find("undo").addEventListener("click", () => this.#undo());
    find("help-open").addEventListener("click", () => find("help").showModal());
    // Off, no dictated word and no key of a screen reader decides anything (WCAG 2.1.4).
    const single = find("single-keys");
    single.checked = localStorage.getItem("single-keys") !== "off";
    single.addEventListener("change", () => localStorage.setItem("single-keys", single.checked ? "on" : "off"));
    for (const button of find("reasons").children) {
      button.addEventListener("click", () => this.decide(false, button.dataset.reason));
    }
    document.addEventListener("keydown", (event) => this.#key(event));
    document.addEventListener("keyup", (event) => {
      if (event.key === " " || event.key.toLowerCase() === "f") this.pictures.flip(false);
    });
    document.addEventListener("click", (event) => {
      if (event.detail) document.activeElement?.closest("button")?.blur(); // Space stays for flipping
    });
    window.addEventListener("blur", () => this.pictures.flip(false));
    window.addEventListener("pagehide", () => {
      fetch("/api/leave", { method: "POST", keepalive: true, headers: { "X-Tab": tab } });
    });
    window.addEventListener("pageshow", (event) => {
      if (event.persisted) location.reload();
    });
    setInterval(() => ask("keep", {}).catch(() => {}), (leaseS * 1000) / 3);
    setInterval(() => { if (!this.card) this.#fill(); }, ASK_AGAIN_MS);
    this.#fill();
  }

  get card() {
    return this.#held[0];
  }

  /** Send the word of the page on this card, and show the next once it is kept. */
  async decide(isAccepted, reason = null) {
    if (!this.card) return;
    if (!this.pictures.areThere()) {
      this.notice("A picture of this card is missing, or still on its way: wait for it, or S for later.");
      return;
    }
    const value = this.page.value(isAccepted, reason);
    if (!value) return;
    await this.#away(`${queue}/decide`, { card: this.card.id, value });
  }

  /** Tell the reviewer something; it stays until the next card. */
  notice(words) {
    find("notice").textContent = words;
    find("notice").hidden = !words;
  }

  async #skip() {
    if (this.card) await this.#away(`${queue}/skip`, { card: this.card.id });
  }

  async #away(path, body) {
    await this.#alone(async () => {
      const answer = await ask(path, body);
      if (!answer.ok && answer.status !== 409) {
        this.notice(answer.body.sentence ?? UNANSWERED);
        return;
      }
      const seconds = (performance.now() - this.#shownAt) / 1000;
      if (seconds < AWAKE_S) this.#paces = [...this.#paces.slice(-19), seconds];
      this.#held.shift();
      this.#show(answer.ok ? "" : answer.body.sentence);
      this.#fill();
    });
  }

  async #undo() {
    await this.#alone(async () => {
      await this.#asked;
      const answer = await ask(`${queue}/undo`, {});
      if (!answer.ok) {
        this.notice(answer.body.sentence ?? UNANSWERED);
        return;
      }
      const { card, value } = answer.body;
      if (!card) {
        this.notice("You have decided nothing here that could be taken back.");
        return;
      }
      this.#held = [card, ...this.#held.filter((one) => one.id !== card.id)];
      this.#show("Taken back: decide anew.", value);
      this.#fill();
    });
  }

  /** One thing at a time; what a server that does not answer costs is a notice. */
  async #alone(work) {
    if (this.#isBusy) return;
    this.#isBusy = true;
    try {
      await work();
    } catch {
      this.notice(UNANSWERED);
    } finally {
      this.#isBusy = false;
    }
  }

  #fill() {
    this.#asked = this.#asked.then(async () => {
      const answer = await ask(`${queue}/claim`, { have: this.#held.length });
      if (!answer.ok) {
        this.notice(answer.body.sentence ?? UNANSWERED);
        return;
      }
      const wasEmpty = !this.card;
      const held = new Set(this.#held.map((card) => card.id));
      this.#held.push(...answer.body.cards.filter((card) => !held.has(card.id)));
      this.#ahead = prefetch(this.#held.slice(1));
      this.#tell(answer.body.progress);
      if (wasEmpty) this.#show("");
    }).catch(() => this.notice("The review server does not answer."));
  }

  #show(words, value = null) {
    const { card } = this;
    this.#choose(false);
    this.notice(words);
    find("card").hidden = !card;
    if (!card) return;
    find("empty").hidden = true;
    find("task").textContent = `${card.task.id} · ${card.task.title}`;
    find("hazard").textContent = card.task.hazard;
    find("words").textContent = `Asked for: ${card.task.words}`;
    find("scene").textContent =
      [card.scene, card.location, card.description].filter(Boolean).join(" · ");
    find("note").value = value?.note ?? "";
    this.page.show(card, value);
    document.body.dataset.card = card.id;
    this.#shownAt = performance.now();
  }

  #tell(progress) {
    find("progress").max = progress.cards || 1;
    find("progress").value = progress.decided;
    const words = [`${progress.decided} of ${progress.cards} decided`, `${progress.mine} by you`];
    if (this.#paces.length >= 3) {
      const pace = [...this.#paces].sort((a, b) => a - b)[Math.floor(this.#paces.length / 2)];
      words.push(`${pace.toFixed(1)} s each`, `at most ${lasting(pace * progress.for_me)} left`);
    }
    find("pace").textContent = words.join(" · ");
    find("empty").hidden = Boolean(this.card);
    const waiting = progress.for_me
      ? [`${count(progress.for_me, "card")} held by other browsers: they come here if left undecided.`]
      : [];
    if (progress.for_others) {
      waiting.push(`${count(progress.for_others, "card")} waiting for another reader: you have read them.`);
    }
    if (progress.third) {
      waiting.push(`On ${progress.third} two readers differ: a third decides, who must be somebody else.`);
    }
    const nothing = progress.cards ? "Every card of this queue is decided."
      : "No candidate has come this far yet: the stages before have to be run first.";
    find("empty-words").textContent = waiting.join(" ") || nothing;
  }

  #choose(isOpen) {
    this.#isChoosing = isOpen && Boolean(this.card);
    find("reasons").hidden = !this.#isChoosing;
    find("reject").setAttribute("aria-expanded", String(this.#isChoosing));
    if (this.#isChoosing) find("reasons").scrollIntoView({ block: "nearest" });
  }

  #key(event) {
    const { key, target } = event;
    const isField = target.matches("input:not([type=checkbox],[type=range]), textarea");
    if (isField) {
      if (key === "Escape") target.blur();
      return;
    }
    if (event.ctrlKey || event.metaKey || find("help").open) return;
    if (key.length === 1 && !find("single-keys").checked) return;
    if (event.repeat && ONCE.test(key)) {
      event.preventDefault();
      return;
    }
    const isControl = target.matches("button, a, input, summary");
    if (this.#act(key, isControl) || (this.card && this.page.key(event))) event.preventDefault();
  }

  #act(key, isControl) {
    const digit = Number.parseInt(key, 10);
    if (this.#isChoosing && digit >= 1) {
      find("reasons").children[digit - 1]?.click();
      return true;
    }
    if (digit >= 1) return this.pictures.look(digit - 1), true;
    const acts = {
      a: () => this.decide(true), r: () => this.#choose(true), s: () => this.#skip(),
      u: () => this.#undo(), n: () => find("note").focus(), w: () => this.pictures.swipeOn(),
      f: () => this.pictures.flip(true), "?": () => find("help").showModal(),
      "+": () => this.pictures.zoomBy(1.5), "-": () => this.pictures.zoomBy(1 / 1.5),
      0: () => this.pictures.zoomOff(), Escape: () => this.#choose(false),
    };
    if (key === " " && isControl) return false;
    if (key === " ") return this.pictures.flip(true), true;
    const act = acts[key] ?? acts[key.toLowerCase()];
    act?.();
    return Boolean(act);
  }
}

/** Ask the server; the answer's status, and its document. */
export async function ask(path, body) {
  const answer = await fetch(`/api/${path}`, {
    method: "POST",
    headers: { "Content-Type": "application/json", "X-Tab": tab },
    body: JSON.stringify(body),
  });
  return { ok: answer.ok, status: answer.status, body: await answer.json().catch(() => ({})) };
}

const count = (number, noun) => `${number} ${noun}${number === 1 ? " is" : "s are"}`;
const lasting = (seconds) =>
  seconds < 90 ? `${Math.ceil(seconds / 10) * 10} s` : seconds < 5400
    ? `${Math.round(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`;
