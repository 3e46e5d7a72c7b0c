// Optional comfort. The form works without this file.
(() => {
  "use strict";
  // An upload shows its progress; a refusal is said in place, and nothing typed is lost.
  const upload = document.querySelector("form[data-upload]");
  // Only what stands in the phase that is chosen can be linked.
  const link = upload?.elements.linked_to;
  const offer = () => {
    for (const one of link.querySelectorAll("[data-phase]")) one.disabled = one.dataset.phase !== upload.elements.phase.value;
    if (link.selectedOptions[0].disabled) link.value = "";
    link.disabled = !link.querySelector("[data-phase]:not([disabled])");
  };
  if (link) {
    offer();
    upload.addEventListener("change", offer);
  }
  upload?.addEventListener("submit", (event) => {
    event.preventDefault();
    const box = upload.querySelector("[data-sending]");
    const [bar, words, share] = box.querySelectorAll("progress, span");
    const button = upload.querySelector("button");
    const say = (text) => { if (words.textContent !== text) words.textContent = text; };
    const refuse = (text) => {
      say(text);
      words.className = "spent";
      share.textContent = "";
      bar.value = 0;
      button.disabled = false;
      if (document.activeElement === document.body) button.focus();
    };
    const request = new XMLHttpRequest();
    box.hidden = false;
    button.disabled = true;
    words.className = "";
    say("Sending …");
    request.upload.onprogress = ({ loaded, total }) => {
      bar.value = total ? loaded / total : 0;
      share.textContent = loaded < total ? ` ${Math.floor((100 * loaded) / total)} %` : "";
      if (loaded >= total) say("Sent. Being kept …");
    };
    request.onload = () => {
      if (request.status < 400) { location.assign(request.responseURL); return; }
      let text = "The server refused the file and gave no reason. Try again.";
      try { const { detail, fields } = JSON.parse(request.response); text = [detail, ...Object.values(fields ?? {})].join(" "); } catch { /* not a problem document */ }
      refuse(text);
    };
    request.onerror = () => refuse("The server cannot be reached. Nothing is lost: try again.");
    request.open("POST", upload.action);
    request.setRequestHeader("Accept", "application/problem+json");
    request.send(new FormData(upload));
  });
})();
