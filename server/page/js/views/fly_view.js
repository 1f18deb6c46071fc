// A drone flown by hand in this browser, beside one that the thesis's PID flies.

import { getJson } from "../api.js";
import { byId, number } from "../dom.js";
import { Controls, gamepad } from "../fly/controls.js";
import { Pilot } from "../fly/pilot.js";
import { AUTOPILOT_DRONE, PILOT_DRONE, SECONDS, beforeTakeOff, worldRequest } from "../fly/plan.js";
import { StickLaw } from "../fly/stick_law.js";
import { Live } from "../live.js";
import { flownTable, inWords, remember } from "./flown_table.js";
import { failure, notice } from "./notice.js";

const TICK_MS = 20;
const NUMBERS_EVERY_MS = 200;
/** The server lists a flight a moment after its pilot has left. */
const LISTED_TRIES = 10;
const LISTED_WAIT_MS = 300;
const READY = "The orange drone is yours, the blue one the PID's.";

export class FlyView {
  #live = new Live();
  #controls = new Controls(byId("sticks"), byId("thumbs"));
  /** @type {Pilot | null} */
  #pilot = null;
  /** @type {StickLaw | null} */
  #law = null;
  #active = false;
  #shown = false;
  /** With the camera on, the pilot sees the drone where the camera saw it; so many rows are done. */
  #camera = false;
  #masked = 0;
  #due_ms = 0;
  #timer = 0;
  #numbers_ms = 0;
  /** Why the page gave the drone back; the server knows of other ends. */
  #why = "";

  /** @param {import("./display.js").Display} display */
  constructor(display) {
    this.display = display;
    byId("fly-panel").addEventListener("submit", (/** @type {Event} */ event) => {
      event.preventDefault();
      this.#start().catch((error) => failure("fly", error));
    });
    byId("fly-stop").addEventListener("click", () => this.#stop("You gave the drone back: the PID flies it on."));
    this.#controls.onEscape = () => this.#stop("You gave the drone back: the PID flies it on.");
    this.#live.addEventListener("flight", () => this.#grow());
    this.#live.addEventListener("trouble", (event) => failure("fly-view", /** @type {CustomEvent} */ (event).detail));
    // nobody flies what he cannot see
    document.addEventListener("visibilitychange", () => document.hidden && this.#stop("You left the page: the PID flies your drone on."));
    byId("fly-task").addEventListener("change", () => this.#ready());
    for (const event of ["gamepadconnected", "gamepaddisconnected"]) window.addEventListener(event, () => this.#showPad());
  }

  /** @param {URLSearchParams} _query */
  async enter(_query) {
    this.display.stage.setLook({ pilot: PILOT_DRONE });
    if (!this.#active) this.#ready();
    this.#active = true;
    this.#showPad();
    await this.#list();
  }

  leave() {
    this.#active = false;
    this.#stop("");
    this.#live.watch(null);
    this.#controls.forget();
    this.display.stage.setLook({ pilot: null });
    this.display.toggle("follow", false);
    byId("fly-numbers").textContent = "";
    for (const subject of ["fly", "fly-view"]) notice(subject, null);
  }

  /** Shows the chosen task before take-off. */
  #ready() {
    this.display.show(beforeTakeOff(byId("fly-task").value), { names: names(), aim: false, ownRings: true, bare: true });
    this.display.toggle("follow", false);
    this.display.stage.behind(0.6);
    this.display.setTime(0);
    this.#say(READY);
    byId("fly-numbers").textContent = "";
  }

  /** Founds a world, takes a drone of it, and flies. */
  async #start() {
    if (this.#pilot) return;
    notice("fly", null);
    const pilot = new Pilot();
    this.#pilot = pilot;
    this.#why = "";
    this.#buttons();
    this.#say("Taking off…");
    this.#camera = byId("fly-camera").checked;
    const request = worldRequest({ task: byId("fly-task").value, camera: this.#camera, delay: byId("fly-delay").checked });
    pilot.addEventListener("over", (event) => this.#over(pilot, /** @type {CustomEvent} */ (event).detail));
    try {
      const { world, joined } = await pilot.begin(request, PILOT_DRONE);
      if (this.#pilot !== pilot) return;
      remember(request.name);
      const law = new StickLaw(joined.interface, joined.observation, joined.tick, byId("fly-keys").value);
      this.#law = law;
      pilot.addEventListener("flown", (event) => {
        const { observation, tick } = /** @type {CustomEvent} */ (event).detail;
        law.see(observation, tick);
      });
      this.#shown = false;
      this.#masked = 0;
      this.#live.watch(world.session);
      this.#controls.setActive(true);
      this.display.toggle("follow", true);
      // keys are for the drone now, not for the button that was pressed
      (this.display.stage.canvas ?? byId("main")).focus({ preventScroll: true });
      this.#say("You fly the orange drone: keep on its ring.");
      this.#due_ms = performance.now();
      this.#tick();
    } catch (error) {
      if (this.#pilot === pilot) this.#over(pilot, error instanceof Error ? error : new Error(String(error)));
    }
  }

  /** Gives an action fifty times a second. Ticks that a slow browser misses are not repeated: the server flew on. */
  #tick() {
    if (!this.#pilot || !this.#law) return;
    this.#pilot.fly(this.#law.action(this.#controls.sticks()));
    const now_ms = performance.now();
    this.#due_ms = Math.max(this.#due_ms + TICK_MS, now_ms - TICK_MS);
    this.#timer = window.setTimeout(() => this.#tick(), Math.max(0, this.#due_ms - now_ms));
  }

  /** @param {string} why */
  #stop(why) {
    if (!this.#pilot) return;
    this.#why = why;
    this.#pilot.leave();
  }

  /** @param {Pilot} pilot @param {Error | null} problem */
  #over(pilot, problem) {
    if (this.#pilot !== pilot) return;
    this.#pilot = null;
    this.#law = null;
    // a drone that was refused leaves its connection open
    pilot.leave();
    clearTimeout(this.#timer);
    this.#controls.setActive(false);
    this.#buttons();
    this.#say(problem ? "The flight did not go on." : this.#why || "Your flight is over.");
    if (problem) failure("fly", problem);
    if (!this.#active) return;
    byId("fly-start").focus({ preventScroll: true });
    this.#result(pilot.world, problem ? "" : this.#why).catch((error) => failure("fly", error));
  }

  /** Says what the server has measured. @param {string | undefined} world @param {string} why */
  async #result(world, why) {
    const row = await this.#list(world);
    if (row && !this.#pilot && this.#active) this.#say([why, inWords(row)].filter(Boolean).join(" "));
  }

  /**
   * The list of flights, once it has the one of this world if one is named.
   * @param {string} [world] @returns {Promise<import("./flown_table.js").Flown | undefined>} The flight in that world.
   */
  async #list(world) {
    for (let left = LISTED_TRIES; this.#active && left > 0; left -= 1) {
      const rows = await getJson("flown");
      byId("flown").replaceChildren(flownTable(rows));
      const own = rows.find((/** @type {any} */ row) => row.world === world);
      if (world === undefined || own) return own;
      await new Promise((later) => setTimeout(later, LISTED_WAIT_MS));
    }
    return undefined;
  }

  #grow() {
    const { flights } = this.#live;
    if (!this.#active || !flights.length) return;
    if (this.#camera) this.#mask(flights[PILOT_DRONE]);
    if (!this.#shown) {
      this.#shown = true;
      this.display.show(flights, { live: true, names: names(), aim: false, ownRings: true });
      this.display.stage.behind();
    }
    this.display.grow(flights);
    this.#numbers(flights);
  }

  /** Puts the drone where the camera last saw it, in the rows that came since. @param {import("../flight.js").Flight} flight */
  #mask(flight) {
    for (; this.#masked < flight.dropped + flight.rows; this.#masked += 1) {
      const row = this.#masked - flight.dropped;
      if (row < 0 || !(flight.get("fix_valid", row) > 0.5)) continue;
      for (const [shown, seen] of [["x", "fix_x"], ["y", "fix_y"], ["z", "fix_z"], ["yaw", "fix_yaw"]]) flight.set(shown, row, flight.get(seen, row));
    }
  }

  /** Shows the errors of both. @param {import("../flight.js").Flight[]} flights */
  #numbers(flights) {
    const now_ms = performance.now();
    if (now_ms - this.#numbers_ms < NUMBERS_EVERY_MS) return;
    this.#numbers_ms = now_ms;
    const off = (/** @type {number} */ drone) => {
      const state = flights[drone].at(flights[drone].lastTime);
      if (!state || state.flying < 0.5) return "down";
      return `${number(100 * Math.hypot(state.x - state.setpoint_x, state.y - state.setpoint_y, state.z - state.setpoint_z), 0)} cm off`;
    };
    byId("fly-numbers").textContent = `${number(flights[0].lastTime, 1)} of ${SECONDS} s · you ${off(PILOT_DRONE)} · PID ${off(AUTOPILOT_DRONE)}`;
  }

  #buttons() {
    const flying = this.#pilot !== null;
    for (const id of ["fly-task", "fly-keys", "fly-camera", "fly-delay"]) byId(id).disabled = flying;
    byId("fly-start").hidden = flying;
    byId("fly-stop").hidden = !flying;
    document.body.toggleAttribute("data-flying", flying);
  }

  /** @param {string} text */
  #say(text) {
    byId("fly-state").textContent = text;
  }

  #showPad() {
    const pad = gamepad();
    byId("fly-pad").textContent = pad ? `Gamepad: ${pad.id}. The right stick moves, the left one turns and changes the height.` : "";
  }
}

function names() {
  const all = [];
  all[AUTOPILOT_DRONE] = "the thesis's PID";
  all[PILOT_DRONE] = "you";
  return all;
}
