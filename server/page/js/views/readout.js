// The numbers of the moment, for people who read and for programs that read aloud.

import { shareWorld } from "../colours.js";
import { make, number } from "../dom.js";

/** @typedef {import("../flight.js").Flight} Flight */

const DEG = 180 / Math.PI;

/** With the column without which there is nothing to tell. @type {[string, (s: import("../flight.js").Row) => string, string?][]} */
const LINES = [
  ["time", (s) => `${number(s.t_s, 2)} s`],
  ["x, y, z", (s) => `${number(s.x)}  ${number(s.y)}  ${number(s.z)} m`],
  ["roll, pitch, yaw", (s) => `${[s.roll, s.pitch, s.yaw].map((angle) => number(angle * DEG, 1)).join("  ")} °`],
  ["speed", (s) => `${number(Math.hypot(s.vx, s.vy, s.vz))} m/s`, "vz"],
  ["off the set-point", (s) => `${number(100 * off_m(s), 1)} cm`, "setpoint_x"],
  ["marker", (s) => (s.fix_valid > 0.5 ? `seen, ${number(1000 * s.fix_age_s, 0)} ms old` : `lost for ${number(s.fix_age_s, 1)} s`), "fix_valid"],
  ["reward", (s) => number(s.reward, 3), "reward"],
];

/** Readings of drones that share a world. @type {[string, (s: import("../flight.js").Row[]) => string][]} */
const SHARED = [
  ["time", ([first]) => `${number(first.t_s, 2)} s`],
  ["flying", (all) => `${aloft(all).length} of ${all.length}`],
  ["separation now", (all) => `${number(Math.min(...aloft(all).map((s) => s.separation_m)))} m`],
  ["least since the start", ([first]) => `${number(first.least_separation_m)} m`],
  ["farthest off the set-point", (all) => `${number(100 * Math.max(...aloft(all).map(off_m)), 1)} cm`],
];

/** @param {import("../flight.js").Row[]} all */
function aloft(all) {
  return all.filter((s) => s.flying > 0.5);
}

/** @param {import("../flight.js").Row} s */
function off_m(s) {
  return Math.hypot(s.x - s.setpoint_x, s.y - s.setpoint_y, s.z - s.setpoint_z);
}

/** @param {HTMLTableElement} table @param {(Flight | null)[]} flights @param {number} time_s */
export function showReadout(table, flights, time_s) {
  if (shareWorld(flights) && flights.filter(Boolean).length > 1) {
    const all = flights.flatMap((flight) => flight?.at(time_s) ?? []);
    table.hidden = !all.length;
    if (all.length) table.replaceChildren(...SHARED.map(([name, say]) => make("tr", {}, make("th", { scope: "row" }, name), make("td", {}, say(all)))));
    return;
  }
  const shown = flights.flatMap((flight, run) => {
    const state = flight?.at(time_s);
    return state ? [{ run, state, name: flight?.header.name ?? "AB"[run] }] : [];
  });
  table.hidden = !shown.length;
  const head = make("tr", {}, make("th", { scope: "col" }, "now"), ...shown.map(({ run, name }) => make("th", { scope: "col", class: `run-${"ab"[run]}` }, name)));
  const lines = LINES.filter(([, , column]) => !column || shown.some(({ state }) => column in state));
  const rows = lines.map(([name, say]) => make("tr", {}, make("th", { scope: "row" }, name), ...shown.map(({ state }) => make("td", {}, say(state)))));
  table.replaceChildren(...(shown.length > 1 ? [head] : []), ...rows);
}
