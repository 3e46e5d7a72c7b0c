// An address for one more browser.
const said = document.getElementById("made");
document.getElementById("address").addEventListener("click", async () => {
  const answer = await fetch("/api/address", { method: "POST" })
    .then((found) => found.json()).catch(() => ({}));
  said.textContent = answer.address ?? answer.sentence ?? "The review server does not answer.";
});
