// An attempt at a scenario, as the API tells it, in the form that the page shows.

import { number } from "../dom.js";

/**
 * @typedef {object} Attempt
 * @property {string} id
 * @property {string} scenario
 * @property {string} controller
 * @property {string} team
 * @property {string} status running, finished, abandoned or damaged
 * @property {number | null} score
 * @property {number | null} low
 * @property {number | null} high
 * @property {number | null} rank
 * @property {number} attempts Of the team with this controller, for which a row of the leaderboard stands.
 * @property {{controller: string, attempts: number, score: number}[]} former Names that the team used before, without a rank.
 * @property {number} episodes
 * @property {number | null} failed
 * @property {Record<string, any>} metrics
 * @property {unknown} at Seconds since 1970.
 * @property {string} signature
 * @property {EpisodeResult[]} flights Only of an attempt that was asked for by itself.
 * @property {string} problem What is wrong with a row that was tampered with.
 *
 * @typedef {{score: number, failed: string | null}} EpisodeResult
 */

/** Metrics with a column: name, unit, factor, digits. @type {Record<string, [string, string, number, number]>} */
export const METRICS = {
  settling_s: ["settling", "s", 1, 2],
  overshoot_m: ["overshoot", "cm", 100, 1],
  rmse_m: ["RMSE", "cm", 100, 1],
  yaw_rmse_deg: ["yaw RMSE", "°", 1, 1],
  effort_deg: ["effort", "°", 1, 1],
  marker_losses: ["marker losses", "", 1, 0],
  touch_mps: ["touch-down", "m/s", 1, 2],
  touch_off_m: ["off target", "cm", 100, 1],
  collisions: ["collisions", "", 1, 0],
  min_separation_m: ["least separation", "cm", 100, 1],
};

/** A row of the leaderboard, or an attempt, whose score lies in its result. @param {any} told @returns {Attempt} */
export function attempt(told) {
  const judged = told.rank === undefined ? (told.result?.score ?? {}) : told;
  return {
    id: String(told.attempt ?? told.id),
    scenario: told.scenario ?? "",
    controller: told.controller ?? "",
    team: told.team ?? "",
    // a row without metrics stands for an attempt that was abandoned
    status: told.status ?? (told.settled === undefined ? "abandoned" : "finished"),
    score: judged.score ?? null,
    low: judged.low ?? null,
    high: judged.high ?? null,
    rank: told.rank ?? null,
    attempts: told.attempts ?? 1,
    former: told.former ?? [],
    episodes: judged.episodes ?? 0,
    failed: judged.failed ?? null,
    metrics: told.result?.metrics ?? told,
    at: told.at,
    signature: told.signature ?? "",
    flights: told.result?.episodes ?? [],
    problem: told.problem ?? "",
  };
}

/** The scenario that is meant by `name@version` or by its name alone. @param {any[]} scenarios @param {string | null} asked */
export function meant(scenarios, asked) {
  return scenarios.find(({ id, name }) => id === asked || name === asked);
}

/** True if there are flights to replay. @param {Attempt} attempt */
export function flown({ status }) {
  return status === "finished";
}

/** The one with the highest score. @param {Attempt[]} attempts */
export function best(attempts) {
  return attempts.filter(flown).reduce((/** @type {Attempt | null} */ so_far, each) => (so_far && (so_far.score ?? 0) >= (each.score ?? 0) ? so_far : each), null);
}

/** @param {Attempt} attempt @param {string} key */
export function metric({ metrics }, key) {
  const [, , factor, digits] = METRICS[key];
  const value = metrics[key];
  return number(typeof value === "number" ? value * factor : value, digits);
}

/** One line about it, for a list to choose from. @param {Attempt} attempt */
export function summary({ controller, team, score, status }) {
  return `${controller} · ${team} · ${score === null ? status : number(score, 1)}`;
}
