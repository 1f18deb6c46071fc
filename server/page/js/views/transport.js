// Play, pause, scrub, speed: buttons and keys of a replay's clock.

import { SPEEDS } from "../clock.js";
import { byId, make, number } from "../dom.js";
import { plainKey } from "./keys.js";

/** @typedef {import("../clock.js").Clock} Clock */

/** @param {Clock} clock @param {() => boolean} active Whether it is this clock that is shown. @param {() => void} onSplit */
export function transport(clock, active, onSplit) {
  const [play, scrub, speed] = [byId("play"), byId("scrub"), byId("speed")];
  if (!speed.options.length) speed.append(...SPEEDS.map((value) => make("option", { value: String(value) }, `×${value}`)));
  const on = (/** @type {EventTarget} */ part, /** @type {string} */ event, /** @type {() => void} */ act) => part.addEventListener(event, () => active() && act());
  on(play, "click", () => clock.toggle());
  on(scrub, "input", () => clock.seek(Number(scrub.value)));
  on(speed, "change", () => clock.setSpeed(Number(speed.value)));
  on(byId("toggle-split"), "click", onSplit);
  on(clock, "change", () => reflect(clock));
  document.addEventListener("keydown", (event) => {
    if (!active() || !plainKey(event) || !pressed(clock, event, onSplit)) return;
    event.preventDefault();
  });
  reflect(clock);
}

/** @param {Clock} clock */
function reflect(clock) {
  const [play, scrub, speed] = [byId("play"), byId("scrub"), byId("speed")];
  play.textContent = clock.playing ? "❚❚" : "▶";
  play.setAttribute("aria-label", clock.playing ? "Pause" : "Play");
  scrub.max = String(clock.end_s);
  scrub.value = String(clock.time_s);
  scrub.setAttribute("aria-valuetext", `${clock.time_s.toFixed(1)} of ${clock.end_s.toFixed(1)} seconds`);
  speed.value = String(clock.speed);
  byId("time").dataset.seconds = String(clock.time_s);
  byId("time").textContent = `${number(clock.time_s)} / ${number(clock.end_s)} s`;
}

/** @param {Clock} clock @param {KeyboardEvent} event @param {() => void} onSplit @returns {boolean} Whether the key has a meaning. */
function pressed(clock, event, onSplit) {
  const step_s = event.shiftKey ? 1 : 0.1;
  const tick_s = 0.02;
  /** @type {Record<string, () => void>} */
  const keys = {
    " ": () => clock.toggle(),
    ArrowLeft: () => clock.seek(clock.time_s - step_s),
    ArrowRight: () => clock.seek(clock.time_s + step_s),
    ",": () => clock.seek(clock.time_s - tick_s),
    ".": () => clock.seek(clock.time_s + tick_s),
    Home: () => clock.seek(0),
    End: () => clock.seek(clock.end_s),
    "[": () => clock.changeSpeed(-1),
    "]": () => clock.changeSpeed(1),
    v: onSplit,
  };
  keys[event.key]?.();
  return event.key in keys;
}
