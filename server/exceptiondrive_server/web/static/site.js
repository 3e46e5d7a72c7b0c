// Optional comfort. Every page works without this file.
(() => {
  "use strict";
  const root = document.documentElement;

  // Colour theme without a reload; the cookie is what the server reads.
  const theme = document.querySelector("form.theme");
  theme?.addEventListener("submit", (event) => {
    const choice = event.submitter?.value;
    if (!choice) return;
    event.preventDefault();
    if (choice === "auto") delete root.dataset.theme;
    else root.dataset.theme = choice;
    const secure = location.protocol === "https:" ? ";secure" : "";
    document.cookie = `theme=${choice};path=/;max-age=31536000;samesite=lax${secure}`;
    for (const button of theme.querySelectorAll("button")) {
      button.setAttribute("aria-pressed", String(button.value === choice));
    }
  });

  // Narrow the rows on the page while typing; Enter asks the server, which searches all pages.
  for (const field of document.querySelectorAll("[data-filter]")) {
    const table = document.getElementById(field.dataset.filter);
    const typedBefore = field.value;
    field.addEventListener("input", () => {
      if (typedBefore) return;
      const words = field.value.toLocaleLowerCase().split(/\s+/).filter(Boolean);
      for (const row of table?.querySelectorAll("tr[id^='e-']") ?? []) {
        const text = row.querySelector("th")?.textContent.toLocaleLowerCase() ?? "";
        row.hidden = !words.every((word) => text.includes(word));
      }
    });
  }

  // A changed choice is applied at once.
  for (const select of document.querySelectorAll("form.filters > label select")) {
    select.addEventListener("change", () => select.form.requestSubmit());
  }

  // Pop-ups close on Escape and on a click elsewhere.
  const popups = [...document.querySelectorAll("details.more, details.menu")];
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    for (const popup of popups.filter((one) => one.open)) {
      popup.open = false;
      popup.querySelector("summary")?.focus();
    }
  });
  document.addEventListener("click", (event) => {
    for (const popup of popups) {
      if (popup.open && !popup.contains(event.target)) popup.open = false;
    }
  });

  // A date to come says how far away it is; without script the date stands alone.
  const inWords = (ms) => {
    const minutes = Math.ceil(ms / 60000);
    const [days, hours] = [Math.floor(minutes / 1440), Math.floor(minutes / 60) % 24];
    return days ? `${days} d ${hours} h` : hours ? `${hours} h ${minutes % 60} min` : `${minutes} min`;
  };
  for (const time of document.querySelectorAll("time[data-countdown]")) {
    const words = document.createElement("span");
    const count = () => {
      const ms = new Date(time.dateTime) - Date.now();
      words.textContent = ms > 0 ? ` (in ${inWords(ms)})` : "";
    };
    count();
    time.append(words);
    setInterval(count, 30000);
  }

  // Commands can be copied by a button that exists only where copying works.
  if (navigator.clipboard) {
    for (const block of document.querySelectorAll("pre[data-copy]")) {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "btn small copy";
      button.textContent = "Copy";
      button.addEventListener("click", async () => {
        await navigator.clipboard.writeText(block.dataset.copy);
        button.textContent = "Copied";
        setTimeout(() => { button.textContent = "Copy"; }, 1600);
      });
      block.after(button);
    }
  }

  // An upload shows its progress; a refusal is said in place, and nothing typed is lost.
  const upload = document.querySelector("form[data-upload]");
  upload?.addEventListener("submit", (event) => {
    event.preventDefault();
    const box = upload.querySelector("[data-sending]");
    const [bar, words] = [box.querySelector("progress"), box.querySelector("p")];
    const button = upload.querySelector("button");
    const say = (text, isBad) => { words.textContent = text; words.className = isBad ? "spent" : ""; };
    const request = new XMLHttpRequest();
    box.hidden = false;
    button.disabled = true;
    say("Sending …");
    request.upload.onprogress = ({ loaded, total }) => {
      bar.value = total ? loaded / total : 0;
      say(loaded < total ? `${Math.floor((100 * loaded) / total)} % sent` : "Sent. Being kept …");
    };
    request.onload = () => {
      if (request.status < 400) { location.assign(request.responseURL); return; }
      button.disabled = false;
      let text = "The server refused the file and gave no reason. Try again.";
      try { const { detail, fields } = JSON.parse(request.response); text = [detail, ...Object.values(fields ?? {})].join(" "); } catch { /* not a problem document */ }
      say(text, true);
    };
    request.onerror = () => { button.disabled = false; say("The server cannot be reached. Nothing is lost: try again.", true); };
    request.open("POST", upload.action);
    request.setRequestHeader("Accept", "application/problem+json");
    request.send(new FormData(upload));
  });

  // What is live follows the server: every event fetches the page anew and swaps the live part.
  // A follower is told at once where things stand; whoever hears nothing (a proxy may hold events back) asks instead.
  const HEARD_WITHIN_MS = 4000;
  const ASK_EVERY_MS = 3000;
  const sources = [];
  let asking = 0;
  let silence = 0;
  const ask = () => { asking ||= setInterval(() => renew(), ASK_EVERY_MS); };
  const stopAsking = () => { clearTimeout(silence); clearInterval(asking); asking = 0; };
  const again = (live) => { if (live?.dataset.againS) setTimeout(renew, 1000 * Number(live.dataset.againS)); };
  const follow = () => {
    const live = document.getElementById("live");
    stopAsking();
    const addresses = (live?.dataset.live ?? "").split(" ").filter(Boolean);
    if (addresses.length) silence = setTimeout(ask, HEARD_WITHIN_MS);
    for (const address of addresses) {
      const source = new EventSource(address);
      source.addEventListener("submission", () => { stopAsking(); renew(); });
      source.addEventListener("error", ask);
      sources.push(source);
    }
    again(live);
  };
  let shown = document.getElementById("live")?.outerHTML;
  const renew = async () => {
    const answer = await fetch(location.href, { headers: { Accept: "text/html" } }).catch(() => null);
    if (!answer?.ok) { again(document.getElementById("live")); return; }
    const fresh = new DOMParser().parseFromString(await answer.text(), "text/html").getElementById("live");
    const now = document.getElementById("live");
    if (!fresh || !now) return;
    if (fresh.outerHTML === shown) { again(fresh); return; }
    const isOther = fresh.dataset.live !== now.dataset.live || fresh.dataset.againS !== now.dataset.againS;
    shown = fresh.outerHTML;
    const places = "a, button, summary";
    const held = [...now.querySelectorAll(places)].indexOf(document.activeElement);
    const words = document.activeElement?.textContent;
    now.replaceWith(document.adoptNode(fresh));
    const place = held < 0 ? null : fresh.querySelectorAll(places)[held]; // the keyboard stays where it was
    if (place?.textContent === words) place?.focus({ preventScroll: true });
    if (!isOther) { again(fresh); return; }
    for (const source of sources.splice(0)) source.close();
    follow();
  };
  follow();
})();
