// An address for one more browser.
const said = document.getElementById("made");
document.getElementById("address").addEventListener("click", async () => {
  const answer = await fetch("/api/address", { method: "POST" }).catch(() => null);
  said.textContent = answer?.ok
    ? (await answer.json()).address
    : "The review server does not answer.";
});
