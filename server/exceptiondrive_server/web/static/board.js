// Optional comfort. The board works without this file.
(() => {
  "use strict";
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
})();
