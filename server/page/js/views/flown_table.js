// Flights by hand, as the server measured them. They are listed, not ranked.

import { make, moment, number } from "../dom.js";

/** @typedef {{world: string, session: string, drone: number, mission: string, at: number, duration_s: number, rms_m: number, autopilot: string, autopilot_rms_m: number | null, end: string | null, late_share: number, effects: string[]}} Flown */

/** @type {Record<string, string>} */
const ENDS = { collided: "collided", hit_floor: "crashed on the floor", left_room: "left the room", done: "done", time: "flew to the end" };
const BAD_ENDS = new Set(["collided", "hit_floor", "left_room"]);
const OWN = "crazyflie.flown";
const OWN_KEPT = 50;
/** More late ticks than this are worth a word. */
const LATE_SHARE = 0.2;

/** Names of worlds that this browser has flown. @returns {string[]} */
function own() {
  try {
    return JSON.parse(localStorage.getItem(OWN) ?? "[]");
  } catch {
    // a browser may keep nothing: then no flight is marked
    return [];
  }
}

/** @param {string} world */
export function remember(world) {
  try {
    localStorage.setItem(OWN, JSON.stringify([...own(), world].slice(-OWN_KEPT)));
  } catch {
    // see above
  }
}

/** @param {Flown} flown */
function switchedOn({ effects }) {
  const named = [effects.includes("camera") ? "camera" : "", effects.includes("cmd_delay") ? "delay" : ""].filter(Boolean);
  const others = effects.filter((effect) => !effect.startsWith("camera") && effect !== "cmd_delay");
  return [...named, ...others].join(", ") || "nothing";
}

/** @param {number | null} metres */
function cm(metres) {
  return metres === null ? "–" : number(100 * metres, 1);
}

/** Result of a flight, in a sentence. @param {Flown} flown */
export function inWords({ end, duration_s, rms_m, autopilot_rms_m }) {
  const how = end === null ? "" : `You ${ENDS[end] ?? end}. `;
  return `${how}In ${number(duration_s, 1)} s you were ${cm(rms_m)} cm off your ring (RMS), the PID ${cm(autopilot_rms_m)} cm.`;
}

/** @type {{head: string, class?: string, cell: (flown: Flown, mine: boolean) => (Node | string)[]}[]} */
const COLUMNS = [
  { head: "when", cell: ({ at }, mine) => [moment(at), ...(mine ? [make("span", { class: "muted" }, " by you")] : [])] },
  { head: "task", cell: ({ mission }) => [mission] },
  { head: "switched on", cell: (flown) => [switchedOn(flown)] },
  { head: "time [s]", class: "number", cell: ({ duration_s }) => [number(duration_s, 1)] },
  { head: "RMS distance by hand [cm]", class: "number", cell: ({ rms_m }) => [make("strong", {}, cm(rms_m))] },
  { head: "the autopilot's [cm]", class: "number", cell: ({ autopilot, autopilot_rms_m }) => [make("span", { title: autopilot }, cm(autopilot_rms_m))] },
  {
    head: "end",
    cell: ({ end, late_share }) => [
      make("span", { class: BAD_ENDS.has(end ?? "") ? "bad" : "" }, end === null ? "gave the drone back" : (ENDS[end] ?? end)),
      ...(late_share > LATE_SHARE ? [make("span", { class: "muted" }, ` ${number(100 * late_share, 0)} % of the ticks came late`)] : []),
    ],
  },
];

/** @param {Flown[]} rows */
export function flownTable(rows) {
  if (!rows.length) return make("p", { class: "nothing" }, "Nobody has flown by hand since the server started.");
  const mine = new Set(own());
  const head = make("tr", { role: "row" }, ...COLUMNS.map(({ head: text, class: kind }) => make("th", { scope: "col", role: "columnheader", class: kind }, text)));
  const body = rows.map((row) =>
    make("tr", { role: "row" }, ...COLUMNS.map(({ head: text, class: kind, cell }) => make("td", { role: "cell", class: kind, "data-label": text }, make("span", {}, ...cell(row, mine.has(row.world)))))),
  );
  const caption = make("caption", {}, "Flights by hand, the newest first; distances from the ring, measured by the server");
  return make("table", { class: "board", role: "table" }, caption, make("thead", { role: "rowgroup" }, head), make("tbody", { role: "rowgroup" }, ...body));
}
