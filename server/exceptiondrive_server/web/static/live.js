// Optional comfort. A page shows the same without this file once it is loaded again.
(() => {
  "use strict";
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
  // A live region that is replaced is not read out: one stays beside what is live.
  const said = (live) => live?.querySelector("[data-said]")?.textContent.trim().replace(/\s+/g, " ") ?? "";
  const region = Object.assign(document.createElement("p"), { className: "vh" });
  region.setAttribute("role", "status");
  document.getElementById("live")?.after(region);
  const renew = async () => {
    const answer = await fetch(location.href, { headers: { Accept: "text/html" } }).catch(() => null);
    if (!answer?.ok) { again(document.getElementById("live")); return; }
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const fresh = page.getElementById("live");
    const now = document.getElementById("live");
    if (!fresh || !now) return;
    if (fresh.outerHTML === shown) { again(fresh); return; }
    const isOther = fresh.dataset.live !== now.dataset.live || fresh.dataset.againS !== now.dataset.againS;
    shown = fresh.outerHTML;
    const places = "a, button, summary";
    const held = [...now.querySelectorAll(places)].indexOf(document.activeElement);
    const words = document.activeElement?.textContent;
    document.title = page.title;
    if (said(fresh) !== said(now)) region.textContent = said(fresh);
    now.replaceWith(document.adoptNode(fresh));
    const place = held < 0 ? null : fresh.querySelectorAll(places)[held]; // the keyboard stays where it was
    if (place?.textContent === words) place?.focus({ preventScroll: true });
    if (!isOther) { again(fresh); return; }
    for (const source of sources.splice(0)) source.close();
    follow();
  };
  follow();
})();
