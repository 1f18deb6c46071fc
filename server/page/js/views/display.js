// A flight on the screen: 3D view, charts, numbers, and the buttons of the 3D view.

import { Charts } from "../charts/charts.js";
import { runColours, shareWorld } from "../colours.js";
import { byId, make } from "../dom.js";
import { FlatStage } from "../scene/flat_stage.js";
import { Stage } from "../scene/stage.js";
import { showReadout } from "./readout.js";
import { plainKey } from "./keys.js";

/** @typedef {import("../flight.js").Flight} Flight */

/** Charts of a live flight are drawn so often; the 3D view as often as rows come. */
const CHARTS_EVERY_MS = 120;
const READOUT_EVERY_MS = 100;
/** A flight that went astray does not make the first look one from far away. */
const AT_FIRST_M = 1;

export class Display {
  /** @type {(Flight | null)[]} */
  flights = [];
  /** The drone of a shared world that is singled out. @type {number | null} */
  #single = null;
  #live = false;
  onSeek = (/** @type {number} */ _time_s) => {};
  #time_s = 0;
  #charts_ms = 0;
  #readout_ms = 0;

  constructor() {
    this.stage = this.#makeStage();
    this.charts = new Charts(byId("charts"), (time_s) => this.onSeek(time_s));
    this.say("");
  }

  /** In 3D, or from above where the browser has no WebGL. */
  #makeStage() {
    try {
      const stage = new Stage(byId("stage"));
      this.#canvas(stage);
      this.#tools(stage);
      return stage;
    } catch {
      byId("tools").hidden = true;
      return new FlatStage(byId("stage"));
    }
  }

  /**
   * @param {(Flight | null)[]} flights Run A and run B, or the drones of a world.
   * @param {{live?: boolean, names?: string[], aim?: boolean, ownRings?: boolean, bare?: boolean}} [options] `ownRings`: set-points of drones have their colours;
   *   `bare`: the 3D view alone, without charts.
   */
  show(flights, { live = false, names = [], aim = true, ownRings = false, bare = false } = {}) {
    clearTimeout(this.settling);
    this.flights = flights;
    this.#single = null;
    this.#live = live;
    this.stage.setLook({ ownRings, single: null });
    this.stage.show(flights);
    if (aim && flights.some(Boolean)) this.stage.home(shareWorld(flights) || flights[0]?.header.name ? undefined : AT_FIRST_M);
    // cones of many drones would hide each other; a log has no camera
    byId("toggle-cone").hidden = shareWorld(flights) || Boolean(flights[0]?.header.name);
    this.charts.show(bare ? [] : flights, live);
    this.#legend(bare ? [] : flights, names);
  }

  /** Flights that charts and numbers show. */
  get #studied() {
    return this.flights.map((flight, drone) => (this.#single === null || this.#single === drone ? flight : null));
  }

  /** One drone among all that share its world; the same one again: all of them. @param {number} drone */
  #singleOut(drone) {
    this.#single = this.#single === drone ? null : drone;
    this.stage.setLook({ single: this.#single });
    for (const [i, entry] of byId("legend").querySelectorAll("button").entries()) entry.setAttribute("aria-pressed", String(i === this.#single));
    byId("toggle-cone").hidden = this.#single === null;
    this.charts.show(this.#studied, this.#live);
    this.#readout(this.#time_s, performance.now());
  }

  /** @param {number} time_s */
  setTime(time_s) {
    this.stage.setTime(time_s);
    this.charts.setTime(time_s);
    const now_ms = performance.now();
    if (now_ms - this.#readout_ms < READOUT_EVERY_MS) clearTimeout(this.settling);
    else this.#readout(time_s, now_ms);
    // skipped numbers are shown once the time stops
    this.settling = setTimeout(() => this.#readout(time_s, performance.now()), READOUT_EVERY_MS);
  }

  /** Rows came to live flights, or their next episode began. @param {Flight[]} flights */
  grow(flights) {
    const time_s = flights[0].lastTime;
    if (flights[0] !== this.flights[0]) {
      this.flights = flights;
      this.stage.show(this.flights);
    }
    this.stage.setTime(time_s);
    clearTimeout(this.settling);
    if (document.hidden) return;
    const wait_ms = this.#charts_ms + CHARTS_EVERY_MS - performance.now();
    // the last row of all is shown as well
    if (wait_ms > 0) this.settling = setTimeout(() => this.grow(flights), wait_ms);
    else this.#details(time_s);
  }

  /** Draws the parts that change less often. @param {number} time_s */
  #details(time_s) {
    this.#charts_ms = performance.now();
    this.charts.refresh(this.#studied);
    this.charts.setTime(time_s);
    this.#readout(time_s, this.#charts_ms);
  }

  /** In place of a flight. @param {string} message Nothing, if empty. */
  say(message) {
    byId("empty").textContent = message;
    byId("empty").hidden = !message;
  }

  /** @param {number} time_s @param {number} now_ms */
  #readout(time_s, now_ms) {
    this.#readout_ms = now_ms;
    this.#time_s = time_s;
    showReadout(byId("readout"), this.#studied, time_s);
  }

  /** @param {(Flight | null)[]} flights @param {string[]} names */
  #legend(flights, names) {
    if (shareWorld(flights)) {
      this.#drones(names);
      return;
    }
    const entry = (/** @type {string} */ kind, /** @type {string} */ text) => make("span", { class: `key ${kind}` }, text);
    const shown = flights.flatMap((flight, run) => (flight ? [run] : []));
    const entries = shown.flatMap((run) => {
      const name = "ab"[run];
      const who = shown.length > 1 || names[run] ? (names[run] ?? "AB"[run]) : "vehicle";
      const has = (/** @type {string} */ column) => flights[run]?.has(column);
      return [entry(`run-${name}`, who), ...(has("fix_x") ? [entry(`dot-${name}`, "camera fix")] : []), ...(has("u_roll") ? [entry(`command-${name}`, "command")] : [])];
    });
    byId("legend").replaceChildren(...entries, ...(flights.some((flight) => flight?.has("setpoint_x")) ? [entry("asked", "set-point")] : []));
    byId("captions").replaceChildren(...shown.map((run) => make("span", { class: `run-${"ab"[run]}` }, names[run] ?? "")));
  }

  /** The legend of a shared world. @param {string[]} names */
  #drones(names) {
    const { length } = this.flights;
    const named = this.flights.map((_, drone) => {
      const made = make("button", { type: "button", class: "key small", "aria-pressed": "false", title: "Single out, or show all again", onclick: () => this.#singleOut(drone) }, names[drone] ?? `drone ${drone}`);
      made.style.setProperty("--own", runColours(drone, length).run);
      return made;
    });
    byId("legend").replaceChildren(...named, make("span", { class: "key asked" }, "least separation so far, set-points"));
    byId("captions").replaceChildren();
  }

  /** @param {Stage} stage */
  #tools(stage) {
    byId("view-home").addEventListener("click", () => stage.home());
    byId("view-behind").addEventListener("click", () => stage.behind());
    byId("view-top").addEventListener("click", () => stage.top());
    byId("view-side").addEventListener("click", () => stage.side());
    byId("toggle-follow").addEventListener("click", () => this.toggle("follow"));
    byId("toggle-cone").addEventListener("click", () => this.toggle("cone"));
    byId("vehicle-scale").addEventListener("change", () => stage.setLook({ vehicleScale: Number(byId("vehicle-scale").value) }));
    document.addEventListener("keydown", (event) => {
      if (!plainKey(event) || byId("flight").hidden) return;
      if (event.key === "f") this.toggle("follow");
      else if (event.key === "c") this.toggle("cone");
      else if (event.key === "h") stage.home();
    });
  }

  /** @param {"follow" | "cone" | "split"} what @param {boolean} [on] The other way round, unless given. */
  toggle(what, on) {
    const now = on ?? !this.stage.look[what];
    this.stage.setLook({ [what]: now });
    byId(`toggle-${what}`).setAttribute("aria-pressed", String(now));
    if (what === "split") byId("stage").classList.toggle("split", now);
  }

  /** @param {Stage} stage */
  #canvas({ canvas, controls, request }) {
    Object.assign(canvas, { tabIndex: 0 });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "3D view of the flight; its numbers are in the table beside it");
    const turn = 0.12;
    /** @type {Record<string, () => void>} */
    const keys = {
      ArrowLeft: () => controls.rotateLeft(turn),
      ArrowRight: () => controls.rotateLeft(-turn),
      ArrowUp: () => controls.rotateUp(turn),
      ArrowDown: () => controls.rotateUp(-turn),
      "+": () => controls.dollyIn(1.15),
      "-": () => controls.dollyOut(1.15),
    };
    canvas.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      const act = keys[event.key];
      if (!act) return;
      act();
      controls.update();
      event.preventDefault();
      event.stopPropagation();
    });
  }
}
