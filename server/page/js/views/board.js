// The leaderboard of a scenario, every attempt at it, and the overview of all scenarios.

import { getCached, getJson } from "../api.js";
import { byId, make } from "../dom.js";
import { address, go, here, note } from "../place.js";
import { attempt, meant } from "./attempt.js";
import { table } from "./board_table.js";
import { failure, notice } from "./notice.js";
import { leftOut, overviewTable, teams } from "./overview_table.js";

/** @typedef {import("./attempt.js").Attempt} Attempt */

/** Terms of a cost: name, unit. @type {Record<string, [string, string]>} */
const COST_TERMS = {
  rmse_m: ["RMSE", "m"],
  yaw_rmse_deg: ["yaw RMSE", "°"],
  travel_degps: ["travel of the tilt commands", "°/s"],
  touch_off_m: ["distance at touch-down", "m"],
  touch_mps: ["speed at touch-down", "m/s"],
  duration_s: ["duration", "s"],
  settling_s: ["settling time", "s"],
};

/** Ending of the name of a scenario at another level than declared. */
const LEVEL = /\.([023])$/;
/** @type {[string, string][]} */
const OTHER_LEVELS = [
  ["0", "Level 0: without the camera"],
  ["2", "Level 2: drawn anew for every flight"],
  ["3", "Level 3: an effect that nobody is told of"],
];

/** @param {Record<string, number>} cost Sizes of figures that cost 1. */
function costFormula(cost) {
  const terms = Object.entries(cost).map(([key, size]) => `${COST_TERMS[key]?.[0] ?? key} / ${size} ${COST_TERMS[key]?.[1] ?? ""}`.trim());
  return `cost = ${terms.join(" + ")}`;
}

/** @param {number} teams */
function counted(teams) {
  return teams ? ` · ${teams} ${teams === 1 ? "team" : "teams"}` : "";
}

export class Board {
  /** @type {any[]} */
  #scenarios = [];
  #scenario = "";
  #loads = 0;
  /** Teams on the leaderboard of each scenario that has any. @type {Map<string, number>} */
  #teams = new Map();
  /** Ids of the attempts to compare, the newest choice last. @type {string[]} */
  #marked = [];

  constructor() {
    byId("board-scenario").addEventListener("change", () => go("board", { scenario: byId("board-scenario").value }));
    byId("every").addEventListener("click", () => {
      note({ all: here().query.get("all") ? null : 1 });
      this.#every().catch((error) => failure("board", error));
    });
  }

  /** @param {URLSearchParams} query */
  async enter(query) {
    const load = (this.#loads += 1);
    const [scenarios, overview] = await Promise.all([getJson("scenarios", { levels: "all" }), getCached("overview").then((answer) => answer.json())]);
    if (load !== this.#loads) return;
    this.#scenarios = scenarios;
    this.#teams = teams(overview);
    byId("overview").replaceChildren(overviewTable(overview));
    byId("overview-rest").textContent = leftOut(overview);
    const asked = query.get("scenario");
    const known = meant(this.#scenarios, asked);
    const found = known ?? this.#scenarios.toSorted((a, b) => this.#count(b) - this.#count(a))[0];
    if (asked !== null && !known) notice("board", `This server has no scenario ${asked}.`);
    else notice("board", null);
    if (!found) {
      byId("ranking").replaceChildren(make("p", { class: "nothing" }, "This server offers no scenario."));
      return;
    }
    if (found.id !== this.#scenario) this.#marked = [];
    this.#scenario = found.id;
    this.#facts(found);
    const rows = (await getJson("leaderboard", { scenario: found.id })).map(attempt);
    if (load !== this.#loads) return;
    this.#show("ranking", rows, "Leaderboard", "No attempt is over yet. The first comes with: crazyflie bench submit --controller thesis");
    await this.#every();
    await this.#key();
  }

  leave() {
    this.#loads += 1;
    notice("board", null);
  }

  /** @param {any} scenario */
  #count({ id }) {
    return this.#teams.get(id) ?? 0;
  }

  /** @param {any} scenario */
  #facts(scenario) {
    const select = byId("board-scenario");
    const options = (/** @type {any[]} */ some) => some.map((each) => make("option", { value: each.id }, each.title + counted(this.#count(each))));
    // an entry of its own for each, and the other levels of all together below
    const declared = this.#scenarios.filter(({ name }) => !LEVEL.test(name));
    const groups = OTHER_LEVELS.map(([level, label]) => make("optgroup", { label }, ...options(this.#scenarios.filter(({ name }) => LEVEL.exec(name)?.[1] === level))));
    select.replaceChildren(...options(declared), ...groups);
    select.value = scenario.id;
    const { name, version, hash, description, episodes, seconds, cost } = scenario;
    byId("scenario-facts").replaceChildren(
      make("p", {}, description),
      make("p", { class: "formula" }, "An episode that does not fail scores 100 · e", make("sup", {}, "−cost"), `, ${costFormula(cost)}`),
      make("p", { class: "muted" }, `${name}@${version} · ${episodes} episodes of ${seconds} s · content hash `, make("code", { title: hash }, String(hash).slice(0, 16))),
    );
  }

  /** Every attempt, if the address asks for them. */
  async #every() {
    const shown = Boolean(here().query.get("all"));
    const button = byId("every");
    button.setAttribute("aria-expanded", String(shown));
    button.textContent = shown ? "Hide the list of every attempt" : "Show every attempt";
    byId("attempts").hidden = !shown;
    if (!shown) return;
    const rows = (await getJson("attempts", { scenario: this.#scenario })).map(attempt);
    this.#show("attempts", rows, "Every attempt, the abandoned ones too", "Nobody has tried yet.");
  }

  /** The key against which signatures can be checked. */
  async #key() {
    const told = await getJson("key");
    byId("key").replaceChildren(`Rows are signed with ${told.algorithm}; the server's public key is `, make("code", {}, told.public_key), ...(told.newest ? [`. Newest row: ${told.newest.number}, SHA-256 `, make("code", {}, told.newest.sha256)] : []));
  }

  /** @param {string} host @param {Attempt[]} rows @param {string} caption @param {string} nothing */
  #show(host, rows, caption, nothing) {
    const marked = { has: (/** @type {string} */ id) => this.#marked.includes(id), set: (/** @type {string} */ id, /** @type {boolean} */ on) => this.#mark(id, on) };
    byId(host).replaceChildren(rows.length ? table(rows, caption, marked) : make("p", { class: "nothing" }, nothing));
    this.#compare();
  }

  /** @param {string} id @param {boolean} on */
  #mark(id, on) {
    this.#marked = this.#marked.filter((each) => each !== id);
    // a third choice takes the place of the first
    if (on) this.#marked = [...this.#marked, id].slice(-2);
    for (const box of document.querySelectorAll("input.mark")) {
      if (box instanceof HTMLInputElement) box.checked = this.#marked.includes(box.value);
    }
    this.#compare();
  }

  #compare() {
    const link = byId("compare");
    const [a, b] = this.#marked;
    link.hidden = !b;
    link.href = b ? address("replay", { a, b }) : "";
  }
}
