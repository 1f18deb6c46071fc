// An attempt at a scenario, as the API tells it, in the form that the page shows.

import { number } from "../dom.js";

/**
 * @typedef {object} Attempt
 * @property {string} id
 * @property {string} scenario
 * @property {string} controller
 * @property {string} team
 * @property {string} status running, finished or abandoned
 * @property {number | null} score
 * @property {number | null} low
 * @property {number | null} high
 * @property {number | null} rank
 * @property {number} episodes
 * @property {number | null} failed
 * @property {Record<string, any>} metrics
 * @property {unknown} at
 * @property {string} signature
 */

/** What is worth a column: name, unit, factor, digits. @type {Record<string, [string, string, number, number]>} */
export const METRICS = {
  settling_s: ["settling", "s", 1, 2],
  overshoot_m: ["overshoot", "cm", 100, 1],
  rmse_m: ["RMSE", "cm", 100, 1],
  yaw_rmse_deg: ["yaw RMSE", "°", 1, 1],
  effort_deg: ["effort", "°", 1, 1],
  marker_losses: ["marker losses", "", 1, 0],
  touch_mps: ["touch-down", "m/s", 1, 2],
  touch_off_m: ["off target", "cm", 100, 1],
};

/** @param {any} told @returns {Attempt} */
export function attempt(told) {
  const score = told.score ?? null;
  return {
    id: String(told.attempt ?? told.id),
    scenario: String(told.scenario ?? ""),
    controller: told.controller ?? "",
    team: told.team ?? "",
    status: told.status ?? told.state ?? (score === null ? "unfinished" : "finished"),
    score,
    low: told.low ?? null,
    high: told.high ?? null,
    rank: told.rank ?? null,
    episodes: Array.isArray(told.episodes) ? told.episodes.length : (told.episodes ?? 0),
    failed: told.failed ?? null,
    metrics: told.metrics ?? told,
    at: told.at ?? told.begun_ms,
    signature: told.signature ?? "",
  };
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
