// Optional comfort. The form works without this file.
(() => {
  "use strict";
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
      bar.value = 0;
      let text = "The server refused the file and gave no reason. Try again.";
      try { const { detail, fields } = JSON.parse(request.response); text = [detail, ...Object.values(fields ?? {})].join(" "); } catch { /* not a problem document */ }
      say(text, true);
    };
    request.onerror = () => { button.disabled = false; bar.value = 0; say("The server cannot be reached. Nothing is lost: try again.", true); };
    request.open("POST", upload.action);
    request.setRequestHeader("Accept", "application/problem+json");
    request.send(new FormData(upload));
  });
})();
