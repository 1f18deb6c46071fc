// The replay of one stored attempt, or of two on one clock.

import { getJson, getReplay } from "../api.js";
import { Clock } from "../clock.js";
import { byId, lessMotion, make } from "../dom.js";
import { here, note } from "../place.js";
import { attempt, best, meant, summary } from "./attempt.js";
import { failure, notice } from "./notice.js";
import { Picker } from "./picker.js";
import { transport } from "./transport.js";

/** @typedef {import("./attempt.js").Attempt} Attempt */

const NOTE_EVERY_MS = 400;

export class ReplayView {
  clock = new Clock();
  #active = false;
  /** @type {any[]} */
  #scenarios = [];
  /** @type {Attempt[]} */
  #attempts = [];
  #scenario = "";
  #noted_ms = 0;
  #loads = 0;

  /** @param {import("./display.js").Display} display */
  constructor(display) {
    this.display = display;
    this.pickers = ["a", "b"].map((name) => new Picker(name, () => this.#chosen()));
    byId("pickers").append(...this.pickers.map((picker) => picker.box));
    byId("replay-scenario").addEventListener("change", () => this.#changeScenario(byId("replay-scenario").value));
    transport(this.clock, () => this.#active, () => this.#split());
    this.clock.addEventListener("change", () => this.#tick());
  }

  /** @param {URLSearchParams} query */
  async enter(query) {
    this.#active = true;
    this.display.onSeek = (time_s) => this.clock.seek(time_s);
    this.clock.pause();
    this.display.show([]);
    this.display.say("Loading…");
    this.display.toggle("split", query.get("view") === "split");
    this.clock.setSpeed(Number(query.get("speed")) || 1);
    this.#scenarios = await getJson("scenarios");
    const asked = query.get("a") ?? query.get("b");
    const scenario = query.get("scenario") ?? (asked ? attempt(await getJson(`attempts/${encodeURIComponent(asked)}`)).scenario : null);
    await this.#setScenario(scenario ?? (await this.#scenarioOfTheBest()));
    const first = asked ? null : best(this.#attempts);
    this.pickers[0].choose(query.get("a") ?? first?.id ?? "", Number(query.get("ea")) || 0);
    this.pickers[1].choose(query.get("b") ?? "", Number(query.get("eb")) || 0);
    // a link to a moment shows that moment
    await this.#load(Number(query.get("t")) || 0, query.get("t") === null);
  }

  leave() {
    this.#active = false;
    this.#loads += 1;
    this.clock.pause();
    this.display.toggle("split", false);
    this.display.say("");
    notice("replay", null);
    notice("team", null);
  }

  /** The scenario to begin with, if nobody says which. */
  async #scenarioOfTheBest() {
    return best((await getJson("attempts")).map(attempt))?.scenario ?? this.#scenarios[0]?.id ?? "";
  }

  /** @param {string} asked */
  async #setScenario(asked) {
    const scenario = meant(this.#scenarios, asked)?.id ?? asked;
    this.#scenario = scenario;
    const select = byId("replay-scenario");
    select.replaceChildren(...this.#scenarios.map(({ id, title }) => make("option", { value: id }, title)));
    select.value = scenario;
    this.#attempts = (await getJson("attempts", { scenario })).map(attempt);
    for (const picker of this.pickers) picker.offer(this.#attempts);
  }

  /** @param {string} scenario */
  async #changeScenario(scenario) {
    try {
      await this.#setScenario(scenario);
      this.pickers[0].choose(best(this.#attempts)?.id ?? "", 0);
      this.pickers[1].choose("", 0);
      this.#chosen();
    } catch (error) {
      failure("replay", error);
    }
  }

  #chosen() {
    const [a, b] = this.pickers;
    note({ scenario: this.#scenario, a: a.id, ea: a.episode || null, b: b.id, eb: b.id ? b.episode || null : null, t: null });
    this.#load(0, true);
  }

  /** Fetches the flights that are chosen and shows them. @param {number} time_s @param {boolean} starts Whether they begin by themselves. */
  async #load(time_s, starts) {
    const load = (this.#loads += 1);
    this.clock.pause();
    this.display.say("Loading…");
    const flights = await Promise.all(this.pickers.map((picker) => this.#flight(picker)));
    if (load !== this.#loads) return;
    if (flights.every((flight) => flight !== undefined)) notice("replay", null);
    const runs = this.pickers.map(({ attempt: chosen }, run) => (chosen ? `${"AB"[run]} ${summary(chosen)}` : ""));
    this.pickers.forEach((picker, run) => picker.end(flights[run]?.[0].header.end));
    // drones that share the air fill the room: one run at a time
    const team = flights.find((drones) => drones && drones.length > 1);
    const shown = team ?? flights.map((drones) => drones?.[0] ?? null);
    const hidden = team && flights.every(Boolean);
    notice("team", hidden ? "Runs of several drones are shown one at a time; this is run A." : null);
    this.clock.end_s = Math.max(0, ...shown.map((flight) => flight?.lastTime ?? 0));
    this.display.show(shown, { names: team ? [] : runs });
    const [a, b] = this.pickers;
    byId("seeds").hidden = Boolean(team) || !(shown[0] && shown[1]) || (a.id === b.id && a.episode === b.episode);
    byId("toggle-split").hidden = Boolean(team) || !this.display.stage.splits || !(shown[0] && shown[1]);
    this.display.say(shown.some(Boolean) ? "" : this.#attempts.length ? "Choose a run to replay." : "No attempt at this scenario is stored yet.");
    this.clock.seek(time_s);
    if (starts && !lessMotion()) this.clock.play();
  }

  /** undefined if it cannot be had. @param {Picker} picker */
  async #flight(picker) {
    if (!picker.id) return null;
    try {
      const [flight, whole] = await Promise.all([getReplay(picker.id, picker.episode), getJson(`attempts/${encodeURIComponent(picker.id)}`)]);
      picker.detail(attempt(whole).flights);
      return flight;
    } catch (error) {
      failure("replay", error);
      return undefined;
    }
  }

  #split() {
    if (byId("toggle-split").hidden) return;
    this.display.toggle("split");
    note({ view: this.display.stage.look.split ? "split" : null });
  }

  #tick() {
    if (!this.#active || here().view !== "replay") return;
    this.display.setTime(this.clock.time_s);
    const now_ms = performance.now();
    if (this.clock.playing && now_ms - this.#noted_ms < NOTE_EVERY_MS) return;
    clearTimeout(this.noting);
    // browsers refuse addresses that change too often
    this.noting = setTimeout(() => this.#note(), this.clock.playing ? 0 : 150);
    this.#noted_ms = now_ms;
  }

  #note() {
    if (!this.#active || here().view !== "replay" || !this.clock.end_s) return;
    note({ t: this.clock.time_s ? Number(this.clock.time_s.toFixed(3)) : null, speed: this.clock.speed === 1 ? null : this.clock.speed });
  }
}
