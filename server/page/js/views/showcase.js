// Flight that the page repeats while nobody flies; the server has simulated it once.

import { getFlight } from "../api.js";
import { Clock } from "../clock.js";
import { byId, lessMotion, number } from "../dom.js";
import { address } from "../place.js";
import { failure, notice } from "./notice.js";

/** @typedef {import("../flight.js").Flight} Flight */

/** Between the end of the flight and its start. */
const REST_MS = 1500;
/** The server is asked so often whether there is a better flight: the answer is mostly that there is none. */
const ASK_EVERY_MS = 30_000;
const RETRY_MS = 3000;
const SWAP = "Eight simulated drones change places.";

export class Showcase {
  #clock = new Clock();
  #shown = false;
  #paused = lessMotion();
  /** The attempt that is shown; null for the eight drones. @type {string | null | undefined} */
  #attempt;
  #asked_ms = -Infinity;
  #timer = 0;

  /** @param {import("./display.js").Display} display */
  constructor(display) {
    this.display = display;
    this.#clock.addEventListener("change", () => this.#tick());
    byId("showcase-play").addEventListener("click", () => {
      this.#paused = !this.#paused;
      this.#playOrPause();
    });
  }

  show() {
    if (this.#shown) return;
    this.#shown = true;
    this.#attempt = undefined;
    this.#asked_ms = -Infinity;
    document.body.toggleAttribute("data-idle", true);
    byId("showcase-bar").hidden = false;
    this.#load();
  }

  hide() {
    if (!this.#shown) return;
    this.#shown = false;
    clearTimeout(this.#timer);
    this.#clock.pause();
    document.body.toggleAttribute("data-idle", false);
    byId("showcase-bar").hidden = true;
    notice("showcase", null);
  }

  /** Shows the best flight of now from its start, or goes on with the one that is shown. */
  async #load() {
    if (performance.now() - this.#asked_ms > ASK_EVERY_MS) {
      this.#asked_ms = performance.now();
      try {
        const flights = await getFlight("showcase");
        if (!this.#shown) return;
        notice("showcase", null);
        this.#take(flights);
      } catch (error) {
        if (!this.#shown) return;
        this.#asked_ms = -Infinity;
        // a flight that is there goes on: the list of sessions tells that the server is gone
        if (this.#attempt === undefined) {
          failure("showcase", error);
          this.#timer = window.setTimeout(() => this.#load(), RETRY_MS);
          return;
        }
      }
    }
    this.#clock.seek(0);
    this.#playOrPause();
  }

  /** @param {Flight[]} flights */
  #take(flights) {
    const about = flights[0].header.showcase ?? null;
    if (this.#attempt === (about?.attempt ?? null)) return;
    this.#attempt = about?.attempt ?? null;
    byId("showcase-title").textContent = about
      ? `Best flight so far: ${about.controller} of ${about.team}, ${about.title}, score ${number(about.score, 1)}`
      : SWAP;
    byId("showcase-replay").hidden = !about;
    if (about) byId("showcase-replay").href = address("replay", { scenario: about.scenario, a: about.attempt, ea: about.episode || null });
    this.display.say("");
    this.display.show(flights, { bare: true });
    this.#clock.end_s = Math.max(...flights.map((flight) => flight.lastTime));
  }

  #playOrPause() {
    clearTimeout(this.#timer);
    byId("showcase-play").textContent = this.#paused ? "Play" : "Pause";
    if (this.#paused) this.#clock.pause();
    else this.#clock.play();
  }

  #tick() {
    if (!this.#shown) return;
    const { time_s, end_s, playing } = this.#clock;
    this.display.stage.setTime(time_s);
    byId("showcase-bar").dataset.seconds = String(time_s);
    if (playing || this.#paused || end_s <= 0 || time_s < end_s) return;
    clearTimeout(this.#timer);
    this.#timer = window.setTimeout(() => this.#load(), REST_MS);
  }
}
