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

  // A double click sends once.
  let sentAt = -2000;
  addEventListener("submit", (event) => {
    if (event.defaultPrevented || event.target.getAttribute("method") !== "post") return;
    if (event.timeStamp - sentAt < 2000) event.preventDefault();
    else sentAt = event.timeStamp;
  });

  // What is shown once is made once: loaded anew, the page is its form's.
  const issued = document.querySelector(".issued");
  if (issued) history.replaceState(null, "", issued.dataset.page);

  // Pop-ups close on Escape, and once a click or the focus is elsewhere.
  const popups = [...document.querySelectorAll("details.more, details.menu")];
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    for (const popup of popups.filter((one) => one.open)) {
      popup.open = false;
      popup.querySelector("summary")?.focus();
    }
  });
  for (const kind of ["click", "focusin"]) {
    document.addEventListener(kind, (event) => {
      for (const popup of popups) if (popup.open && !popup.contains(event.target)) popup.open = false;
    });
  }

  // A date to come says how far away it is; without script the date stands alone.
  const inWords = (ms) => {
    const minutes = Math.ceil(ms / 60000);
    const [days, hours] = [Math.floor(minutes / 1440), Math.floor(minutes / 60) % 24];
    return days > 2 ? `${days} days` : days ? `${days} d ${hours} h` : hours ? `${hours} h ${minutes % 60} min` : `${minutes} min`;
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
    for (const block of document.querySelectorAll("pre.term, pre.code")) {
      const bare = block.cloneNode(true);
      for (const remark of bare.querySelectorAll(".d")) remark.remove();
      const text = block.dataset.copy ?? bare.textContent.trim() + "\n";
      const button = document.createElement("button");
      button.type = "button";
      button.className = "btn small copy";
      button.textContent = "Copy";
      button.addEventListener("click", async () => {
        await navigator.clipboard.writeText(text);
        button.textContent = "Copied";
        setTimeout(() => { button.textContent = "Copy"; }, 1600);
      });
      block.prepend(button);
    }
  }
})();
