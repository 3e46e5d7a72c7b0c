// Optional comfort. The board works without this file.
(() => {
  "use strict";
  const board = document.getElementById("board");
  const form = board?.querySelector("form.filters");
  if (!form) return;
  const tray = document.getElementById("chosen");
  const phase = board.dataset.phase;
  const kept = (storage, name) => {
    try { return JSON.parse(storage.getItem(`${name}:${phase}`)) ?? []; } catch { return []; }
  };
  const keep = (storage, name, value) => {
    try { storage.setItem(`${name}:${phase}`, JSON.stringify(value)); } catch { /* nothing is kept */ }
  };

  // Another order, page or filter takes the place of the rows; focus stays where it was.
  const PARTS = ["#results", "#chips", "#facts-of .pop", "#board .seg", "#kept", "#board .foot", "#families"];
  const here = () => location.pathname + location.search;
  let asked = 0;
  let shown = here();
  const show = async (url, isStep) => {
    const mine = ++asked;
    const answer = await fetch(url, { headers: { Accept: "text/html" } }).catch(() => null);
    if (mine !== asked) return; // a later wish is on its way
    if (!answer?.ok) { location.assign(url); return; }
    const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
    if (mine !== asked) return;
    const to = new URL(answer.url);
    if (to.pathname + to.search !== shown) history[isStep ? "pushState" : "replaceState"](null, "", to.pathname + to.search);
    shown = here();
    // Of a newer board all is shown, not its rows alone.
    if (fresh.getElementById("board")?.dataset.board !== board.dataset.board) { location.reload(); return; }
    const held = document.activeElement;
    const [id, place, name] = [held?.id, held?.parentElement?.closest("[id]")?.id, held?.dataset.key];
    for (const part of PARTS) {
      const [old, now] = [document.querySelector(part), fresh.querySelector(part)];
      if (old && now) old.replaceWith(document.adoptNode(now));
    }
    for (const tip of fresh.querySelectorAll("body > .tip")) if (!document.getElementById(tip.id)) document.body.append(tip);
    document.getElementById("found").textContent = fresh.getElementById("found").textContent;
    form.elements.sort.innerHTML = fresh.querySelector("[name=sort]").innerHTML;
    const again = (id && document.getElementById(id)) || (name && document.querySelector(`#${place} [data-key="${name}"]`));
    again?.focus({ preventScroll: true });
    dress();
    return true;
  };
  const wanted = () => `/?${new URLSearchParams(new FormData(form))}`;
  // A link within the page changes its fragment alone.
  addEventListener("popstate", () => { if (here() !== shown) location.reload(); });
  board.addEventListener("click", async (event) => {
    const link = event.target.closest("a.s, a.chip, .pager a, .seg a, .nothing a");
    if (!link || event.metaKey || event.ctrlKey || event.shiftKey || event.button) return;
    event.preventDefault();
    const isPage = link.closest(".pager");
    await show(link.href, true);
    if (!isPage) return;
    board.scrollIntoView();
    board.querySelector(".pager [aria-current]")?.focus({ preventScroll: true });
  });
  form.addEventListener("submit", (event) => {
    if (!["q", "sort"].includes(document.activeElement?.name)) return;
    event.preventDefault();
    show(wanted(), true);
  });

  form.elements.sort.addEventListener("change", () => form.requestSubmit());

  // What is typed is looked for among all entries, by the server; "/" leads to the field.
  // The first letters of a search are a step, so that Back leads to the list as it was; the others take their place.
  let pause = 0, isUnderWay = false;
  form.elements.q.addEventListener("input", () => {
    clearTimeout(pause);
    pause = setTimeout(async () => { if (await show(wanted(), !isUnderWay)) isUnderWay = true; }, 160);
  });
  form.elements.q.addEventListener("change", () => { isUnderWay = false; });
  document.addEventListener("keydown", (event) => {
    if (event.key !== "/" || event.target.closest("input, select, textarea")) return;
    event.preventDefault();
    form.elements.q.focus();
  });

  // Rows that are ticked stay chosen on other pages of the board, until the window closes.
  const most = Number(tray.dataset.most);
  let chosen = kept(sessionStorage, "chosen");
  const tell = () => {
    for (const tick of board.querySelectorAll(".tick")) {
      tick.checked = chosen.includes(tick.value);
      tick.disabled = !tick.checked && chosen.length >= most;
    }
    for (const old of tray.querySelectorAll("[data-elsewhere]")) old.remove();
    for (const key of chosen.filter((one) => !document.getElementById(`e-${one}`))) {
      const field = Object.assign(document.createElement("input"), { type: "hidden", name: "more", value: key });
      field.dataset.elsewhere = "";
      tray.append(field);
    }
    tray.querySelector(".n").textContent = `${chosen.length} chosen${chosen.length >= most ? ", the most" : ""}`;
    tray.toggleAttribute("data-open", chosen.length > 0);
    keep(sessionStorage, "chosen", chosen);
  };
  board.addEventListener("change", (event) => {
    if (!event.target.matches(".tick")) return;
    chosen = chosen.filter((one) => one !== event.target.value);
    if (event.target.checked) chosen.push(event.target.value);
    tell();
  });
  tray.addEventListener("reset", (event) => { event.preventDefault(); chosen = []; tell(); });

  // Pinned rows stand on top of every page of this phase, on this device.
  let pinned = kept(localStorage, "pinned");
  const pin = (key, name) => {
    const isOn = pinned.some((one) => one.key === key);
    pinned = isOn ? pinned.filter((one) => one.key !== key) : [...pinned, { key, name }];
    keep(localStorage, "pinned", pinned);
    show(location.href, false);
  };
  const fetched = async ({ name, key }) => {
    const answer = await fetch(`/?${new URLSearchParams({ phase, q: name, rows: "all" })}`).catch(() => null);
    if (!answer?.ok) return null;
    return new DOMParser().parseFromString(await answer.text(), "text/html").getElementById(`e-${key}`);
  };
  const placePinned = async () => {
    const table = document.getElementById("board-rows");
    if (!pinned.length || !table || location.search.includes("board=")) return;
    const top = Object.assign(document.createElement("tbody"), { className: "pinned" });
    top.setAttribute("role", "rowgroup");
    for (const one of pinned) {
      const row = document.getElementById(`e-${one.key}`) ?? (await fetched(one));
      if (row) top.append(document.adoptNode(row));
    }
    table.tHead.after(top);
    addPins();
    tell();
  };
  const addPins = () => {
    for (const row of board.querySelectorAll("tr[id^='e-']")) {
      if (row.querySelector(".pin")) continue;
      const [key, name] = [row.id.slice(2), row.querySelector(".pn").textContent];
      const button = Object.assign(document.createElement("button"), { type: "button", className: "pin" });
      button.setAttribute("aria-pressed", String(pinned.some((one) => one.key === key)));
      button.setAttribute("aria-label", `${row.querySelector(".tick").ariaLabel.replace("Compare", "Pin")} on top`);
      button.innerHTML = '<svg class="ic" aria-hidden="true"><use href="#i-pin"/></svg>';
      button.addEventListener("click", () => pin(key, name));
      row.querySelector(".nm").append(button);
    }
  };

  // How high a row is.
  const choices = board.querySelector(".density");
  const dense = (isDense) => {
    board.classList.toggle("dense", isDense);
    for (const one of choices.querySelectorAll("button")) one.setAttribute("aria-pressed", String((one.value === "dense") === isDense));
  };
  choices.hidden = false;
  choices.addEventListener("click", (event) => {
    if (!event.target.value) return;
    try { localStorage.setItem("density", event.target.value); } catch { /* for this page alone */ }
    dense(event.target.value === "dense");
  });
  let density = "";
  try { density = localStorage.getItem("density") ?? ""; } catch { /* the usual one */ }
  dense(density === "dense");

  const dress = () => { addPins(); tell(); placePinned(); };
  dress();
})();
