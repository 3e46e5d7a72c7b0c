"use strict";
// Scenes in motion: moves what the server drew. All numbers stand in the page; nothing is measured here.
(() => {
  const WORDS = { clear: "clear", close: "too close", hit: "hit" };
  const isStill = matchMedia("(prefers-reduced-motion: reduce)");

  const corners = (text) => text.split(" ").map((pair) => pair.split(",").map(Number));
  const boxesOf = (shape) => shape?.dataset.boxes?.split(";").map(corners) ?? [];
  const text = (points) => points.map((point) => point.map((each) => each.toFixed(1)).join(",")).join(" ");
  const between = (a, b, share) => a.map((corner, i) => corner.map((value, j) => value + (b[i][j] - value) * share));

  // corners of the convex hull (monotone chain), as the server has it for whole steps
  const hull = (points) => {
    const ordered = points.toSorted((a, b) => a[0] - b[0] || a[1] - b[1]);
    const chain = (order) => {
      const kept = [];
      for (const p of order) {
        while (kept.length > 1) {
          const [a, b] = kept.slice(-2);
          if ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0) break;
          kept.pop();
        }
        kept.push(p);
      }
      return kept.slice(0, -1);
    };
    return [...chain(ordered), ...chain(ordered.toReversed())];
  };

  // one footprint along its boxes, and the tube that it leaves
  const mover = (shape, pieces) => {
    const boxes = boxesOf(shape);
    const whole = pieces.map((piece) => piece.getAttribute("points"));
    const last = boxes.length - 1;
    return (at) => {
      if (last < 0) return;
      const step = Math.min(Math.floor(at + 1e-9), last);
      const box = step < last ? between(boxes[step], boxes[step + 1], at - step) : boxes[last];
      shape.setAttribute("points", text(box));
      const isSwept = pieces.length === last; // else the tube is the footprints alone
      pieces.forEach((piece, k) => {
        const isDone = isSwept ? k < step : k <= step;
        const isUnderWay = isSwept && k === step && at > step;
        piece.setAttribute("points", isDone ? whole[k] : isUnderWay ? text(hull([...boxes[k], ...box])) : "");
      });
    };
  };

  const start = (player) => {
    const stepS = Number(player.dataset.step);
    const [time, blend] = ["[data-time]", "[data-blend]"].map((name) => player.querySelector(name));
    const button = player.querySelector("[data-play]"), shown = player.querySelector("output");
    const endS = Number(time.max);
    const runs = [...player.querySelectorAll(".mo-run")].flatMap((run) => [
      mover(run.querySelector(".mo-before"), []),
      mover(run.querySelector(".mo-car"), [...run.querySelectorAll(".tube > *")]),
    ]);
    const lines = [...player.querySelectorAll(".mo-now")].map((line) => {
      const { left, right } = line.closest(".mo").dataset;
      return (share) => ["x1", "x2"].forEach((end) => line.setAttribute(end, Number(left) + share * (right - left)));
    });
    const readings = [...player.querySelectorAll(".mo-read li")].map((item) => {
      const [clear, levels] = [item.dataset.clear, item.dataset.levels].map((each) => each.split(" "));
      const place = item.querySelector("b");
      return (step) => {
        if (!clear[step]) return;
        place.className = levels[step];
        place.textContent = `${clear[step]} m, ${WORDS[levels[step]]}`;
      };
    });

    const show = (seconds) => {
      const at = seconds / stepS, step = Math.floor(at + 1e-9);
      time.value = String(seconds);
      time.setAttribute("aria-valuetext", `${seconds.toFixed(1)} seconds`);
      shown.textContent = `${seconds.toFixed(1)} s`;
      runs.forEach((move) => move(at));
      lines.forEach((place) => place(seconds / endS));
      readings.forEach((read) => read(step));
    };
    const mix = (share) => {
      blend.setAttribute("aria-valuetext", share === 1 ? "the scene with hazard" : share === 0 ? "the original scene"
        : `${Math.round(share * 100)} % of the way to the scene with hazard`);
      const set = (name, value) => player.querySelectorAll(name).forEach((part) => part.setAttribute("opacity", value));
      set(".mo-hazard", share);
      set(".mo-after", share);
      set(".mo-before", 1 - share);
      player.classList.toggle("original", share < 0.5);
    };

    let frame = 0;
    const stop = () => {
      cancelAnimationFrame(frame);
      frame = 0;
      button.textContent = isStill.matches ? "Next step" : "Play";
      shown.ariaLive = "polite";
    };
    const run = () => {
      let from = Number(time.value) >= endS ? 0 : Number(time.value);
      let before = null;
      button.textContent = "Pause";
      shown.ariaLive = "off"; // ten times a second is too much to hear
      const next = (now) => {
        from = Math.min(from + (now - (before ?? now)) / 1000, endS);
        before = now;
        show(from);
        if (from < endS && player.isConnected) frame = requestAnimationFrame(next);
        else stop();
      };
      frame = requestAnimationFrame(next);
    };
    button.addEventListener("click", () => {
      if (frame) { stop(); return; }
      if (!isStill.matches) { run(); return; }
      const seconds = Number(time.value) + stepS; // whoever wants no motion goes step by step
      show(seconds > endS + 1e-9 ? 0 : Math.floor(seconds / stepS + 1e-9) * stepS);
    });
    time.addEventListener("input", () => { stop(); show(Number(time.value)); });
    blend.addEventListener("input", () => mix(Number(blend.value) / 100));
    isStill.addEventListener("change", stop);
    stop();
    mix(1);
    player.querySelector(".mo-bar").hidden = false;
  };

  const scenesOf = async (address) => {
    const answer = await fetch(address, { headers: { Accept: "text/html" } }).catch(() => null);
    if (!answer?.ok) return null;
    return new DOMParser().parseFromString(await answer.text(), "text/html").getElementById("motion");
  };
  // the scenes of another page in the place of these; the words above them stay
  const place = (fresh) => {
    const now = document.getElementById("motion");
    if (!fresh || !now) return;
    const isHeld = now.contains(document.activeElement);
    now.replaceWith(document.adoptNode(fresh));
    begin();
    if (isHeld) fresh.querySelector("form button")?.focus({ preventScroll: true });
  };

  const begin = () => {
    document.querySelectorAll(".player").forEach(start);
    const form = document.querySelector(".mo-form");
    form?.addEventListener("submit", async (event) => {
      event.preventDefault();
      place(await scenesOf(`/scenes?${new URLSearchParams(new FormData(form))}`));
    });
  };
  begin();
  const waiting = document.querySelector("[data-scenes]");
  if (!waiting) return;
  // What grows while the page scrolls moves the place that a link leads to: so not on the way, nor above what is read.
  let pause = 0, fresh;
  const rest = () => { clearTimeout(pause); pause = setTimeout(look, 150); };
  const look = async () => {
    const { top, bottom } = waiting.getBoundingClientRect();
    if (bottom < 76 || top > innerHeight + 400) return;
    if (fresh === undefined) {
      fresh = null;
      fresh = await scenesOf(waiting.dataset.scenes);
      rest();
    } else if (fresh) {
      ["scroll", "resize"].forEach((name) => removeEventListener(name, rest));
      place(fresh);
    }
  };
  ["scroll", "resize"].forEach((name) => addEventListener(name, rest, { passive: true }));
  rest();
})();
