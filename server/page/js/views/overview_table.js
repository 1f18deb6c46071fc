// Controllers against scenarios: one cell for each leaderboard that a controller is on.

import { make, number } from "../dom.js";
import { address } from "../place.js";

/** @typedef {{rank: number | null, attempt: string, score: number, failed: number, episodes: number}} Score */
/** @typedef {{scenarios: {id: string, title: string}[], rows: {controller: string, team: string, scores: (Score | null)[]}[], left_out: number}} Overview */

/** The name without its version. @param {string} id */
function short(id) {
  return id.split("@")[0];
}

/** @param {Score | null} score */
function cell(score) {
  if (!score) return make("span", { class: "muted", title: "not flown" }, "–");
  const { rank, attempt, failed, episodes } = score;
  const how = `${rank === null ? "no rank yet" : `rank ${rank}`}, ${failed} of ${episodes} episodes failed; replay`;
  const text = number(score.score, 1);
  return make("a", { href: address("replay", { a: attempt }), title: how, class: rank === 1 ? "first" : undefined }, text);
}

/** Scenarios that nobody has flown have no column. @param {Overview} overview */
export function overviewTable({ scenarios, rows }) {
  if (!rows.length) return make("p", { class: "nothing" }, "No attempt is over yet. The first comes with: crazyflie bench submit --controller thesis-pid");
  const flown = scenarios.map((scenario, at) => ({ ...scenario, at })).filter(({ at }) => rows.some(({ scores }) => scores[at]));
  const head = make(
    "tr",
    { role: "row" },
    make("th", { scope: "col", role: "columnheader" }, "controller"),
    ...flown.map(({ id, title }) => make("th", { scope: "col", role: "columnheader", class: "number" }, make("a", { href: address("board", { scenario: id }), title }, short(id)))),
  );
  const body = rows.map(({ controller, team, scores }) =>
    make(
      "tr",
      { role: "row" },
      make("th", { scope: "row", role: "rowheader", class: "who" }, make("strong", {}, controller), make("span", { class: "muted" }, team)),
      ...flown.map(({ id, at }) => make("td", { role: "cell", class: "number", "data-label": short(id) }, cell(scores[at]))),
    ),
  );
  return make("table", { class: "board overview", role: "table" }, make("thead", { role: "rowgroup" }, head), make("tbody", { role: "rowgroup" }, ...body));
}

/** Sentences about the scenarios that the table omits. @param {Overview} overview */
export function leftOut({ scenarios, rows, left_out }) {
  const unflown = scenarios.filter((_, at) => !rows.some(({ scores }) => scores[at])).map(({ id }) => short(id));
  const sentences = rows.length ? ["Rows are in the order of the sum of their scores; bold is the best of a scenario. A score leads to its replay."] : [];
  if (unflown.length) sentences.push(`Not flown yet: ${unflown.join(", ")}.`);
  if (left_out) sentences.push(`${left_out} more ${left_out === 1 ? "row is" : "rows are"} not shown.`);
  return sentences.join(" ");
}

/** Number of teams on the leaderboard of each scenario that has any. @param {Overview} overview @returns {Map<string, number>} */
export function teams({ scenarios, rows }) {
  const flown = scenarios.map(({ id }, at) => /** @type {[string, number]} */ ([id, new Set(rows.filter(({ scores }) => scores[at]).map(({ team }) => team)).size]));
  return new Map(flown.filter(([, count]) => count > 0));
}
