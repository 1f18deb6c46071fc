// Gains by hand: sliders, the loop on paper, and a thousand noisy flights of the simulator for what they say.

import { getJson } from "../api.js";
import { LoopPlots } from "../charts/loop_plots.js";
import { byId, make, number } from "../dom.js";
import { note } from "../place.js";
import { failure, notice } from "./notice.js";
import { fillVehicles } from "./vehicles.js";

/** @typedef {"kp" | "ki" | "kd"} Gain */
/** @typedef {{kp: number, ki: number, kd: number}} Gains */
/** @typedef {{table_7_1: Gains, report: any, band: any}} Answer */

/** @type {Gain[]} */
const GAINS = ["kp", "ki", "kd"];
const TITLES = { kp: "Kp", ki: "Ki", kd: "Kd" };
/** Less than these is little; less than nothing is unstable. @type {Record<string, number>} */
const GOOD_MARGINS = { phase_deg: 30, gain_db: 6 };
/** @type {Record<string, string>} */
const LOW = { warn: ", little" };
/** A slider goes from a tenth of table 7.1's gain to ten times it. */
const DECADES = 1;
const CHOICES = { loop: "tuner-loop", vehicle: "tuner-vehicle", vertical: "tuner-form", sensors: "tuner-sensors" };

/** @param {number} margin @param {number} good */
function grade(margin, good) {
  if (margin <= 0) return "bad";
  return margin < good ? "warn" : "good";
}

export class Tuner {
  #plots = new LoopPlots(byId("tuner-plots"));
  /** Newest question while an answer is awaited; older ones are dropped. @type {Record<string, string> | null} */
  #next = null;
  #asking = false;
  #shown = false;
  /** Table 7.1's gains of the loop that is shown. @type {Gains | null} */
  #table = null;
  /** Gains that the address or the sliders say; what is missing is table 7.1's. @type {Partial<Gains>} */
  #gains = {};
  /** Vertical forms by vehicle. @type {Record<string, string[]>} */
  #verticals = {};

  constructor() {
    for (const id of Object.values(CHOICES)) byId(id).addEventListener("change", () => this.#choose());
    byId("tuner-reset").addEventListener("click", () => this.#choose());
    byId("tuner-gains").append(...GAINS.map((gain) => this.#slider(gain)));
  }

  /** @param {URLSearchParams} query */
  async enter(query) {
    this.#shown = true;
    this.#verticals = await fillVehicles(byId("tuner-vehicle"));
    for (const [name, id] of Object.entries(CHOICES)) {
      const asked = query.get(name);
      if ([...byId(id).options].some((option) => option.value === asked)) byId(id).value = asked;
    }
    this.#forms();
    this.#table = null;
    this.#gains = {};
    for (const gain of GAINS) {
      const asked = Number.parseFloat(query.get(gain) ?? "");
      if (Number.isFinite(asked)) this.#gains[gain] = asked;
    }
    await this.#ask();
  }

  leave() {
    this.#shown = false;
    this.#next = null;
    notice("tuner", null);
  }

  /** The forms that the vehicle has. A height command has no height loop. */
  #forms() {
    const form = byId("tuner-form");
    const has = this.#verticals[byId("tuner-vehicle").value] ?? [];
    for (const option of form.options) {
      option.disabled = !has.includes(option.value) || (option.value === "height" && byId("tuner-loop").value === "z");
    }
    if (form.selectedOptions[0]?.disabled) form.value = "thrust";
  }

  /** Another loop, form or rig: from table 7.1's gains. */
  #choose() {
    this.#forms();
    this.#table = null;
    this.#gains = {};
    this.#change();
  }

  #change() {
    const chosen = Object.fromEntries(Object.entries(CHOICES).map(([name, id]) => [name, byId(id).value]));
    note({ ...chosen, ...Object.fromEntries(GAINS.map((gain) => [gain, this.#gains[gain] ?? null])) });
    this.#ask().catch((error) => failure("tuner", error));
  }

  /** Asks for what is chosen, as soon as the answer before is there. */
  async #ask() {
    const query = /** @type {Record<string, string>} */ ({});
    for (const [name, id] of Object.entries(CHOICES)) query[name] = byId(id).value;
    for (const [gain, value] of Object.entries(this.#gains)) query[gain] = String(value);
    this.#next = query;
    if (this.#asking) return;
    this.#asking = true;
    try {
      while (this.#next && this.#shown) {
        const asked = this.#next;
        this.#next = null;
        const answer = await getJson("tuner", asked);
        if (this.#shown) this.#show(answer);
      }
      notice("tuner", null);
    } finally {
      this.#asking = false;
    }
  }

  /** @param {Answer} answer */
  #show(answer) {
    // a question that waits was asked after a choice: this answer's gains are not its own
    if (!this.#table && !this.#next) {
      this.#table = answer.table_7_1;
      for (const gain of GAINS) this.#place(gain, this.#gains[gain] ?? answer.report.gains[gain]);
    }
    const { margins, step } = answer.report;
    const seconds = (/** @type {unknown} */ value) => (value === null ? "never" : `${number(value, 2)} s`);
    // a curve that never crosses has all the margin that there is
    const grades = ["phase_deg", "gain_db"].map((key) => grade(margins[key] ?? Infinity, GOOD_MARGINS[key]));
    const stable = !grades.includes("bad");
    const { crashed, flights } = answer.band;
    const figures = [
      ["on paper", stable ? "stable" : "unstable", stable ? grades.find((each) => each === "warn") ?? "good" : "bad"],
      ["phase margin", `${number(margins.phase_deg, 0)}°${LOW[grades[0]] ?? ""}`, grades[0]],
      ["gain margin", `${number(margins.gain_db, 1)} dB${LOW[grades[1]] ?? ""}`, grades[1]],
      ["rise", seconds(step.figures.rise_s)],
      ["overshoot", `${number(100 * step.figures.overshoot, 0)} %`],
      ["settled", seconds(step.figures.settling_s)],
      ["crashed", `${crashed} of ${flights}`, crashed === 0 ? "good" : "bad"],
    ];
    byId("tuner-figures").replaceChildren(
      ...figures.map(([name, value, kind]) => make("div", {}, make("dt", {}, name), make("dd", { class: kind }, value))),
    );
    this.#plots.show(answer);
  }

  /** @param {Gain} gain */
  #slider(gain) {
    const input = make("input", { type: "range", id: `tuner-${gain}`, min: -DECADES, max: DECADES, step: 0.01, value: 0, oninput: () => this.#slide(gain) });
    return make("label", { class: "gain" }, make("span", {}, TITLES[gain]), input, make("output", { id: `tuner-${gain}-value`, for: `tuner-${gain}` }, "–"));
  }

  /** @param {Gain} gain */
  #slide(gain) {
    if (!this.#table) return;
    const at = Number(byId(`tuner-${gain}`).value);
    const own = this.#table[gain];
    // table 7.1 gives the yaw no integral: there the slider begins at none and ends at its Kp
    const value = own === 0 ? (this.#table.kp * (at + DECADES)) / (2 * DECADES) : own * 10 ** at;
    this.#gains[gain] = Number(value.toPrecision(4));
    this.#say(gain, this.#gains[gain] ?? 0);
    this.#change();
  }

  /** Puts a slider where a gain is. @param {Gain} gain @param {number} value */
  #place(gain, value) {
    if (!this.#table) return;
    const own = this.#table[gain];
    const at = own === 0 ? (2 * DECADES * value) / this.#table.kp - DECADES : Math.log10(value / own);
    byId(`tuner-${gain}`).value = String(at);
    this.#say(gain, value);
  }

  /** @param {Gain} gain @param {number} value */
  #say(gain, value) {
    byId(`tuner-${gain}-value`).textContent = String(Number(value.toPrecision(4)));
  }
}
