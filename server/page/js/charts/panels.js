// Which strip charts there are, and the numbers in them.

import { number } from "../dom.js";
import { off_m } from "../flight.js";

/** @typedef {import("../flight.js").Flight} Flight */
/** @typedef {"state" | "setpoint" | "fix" | "command" | "pair"} Kind */
/** @typedef {(flight: Flight, row: number) => number} Worked What no column has. */
/** @typedef {{kind: Kind, column: string | Worked}} Trace */
/** @typedef {{title: string, unit: string, digits: number, factor: number, least: number, traces: Trace[], told?: (all: import("../flight.js").Row[]) => string}} Panel */
/** @typedef {{run: number, kind: Kind}} Drawn */

const DEG = 180 / Math.PI;
/** Order of drawing: curves drawn first lie below. @type {Record<Kind, number>} */
export const DEPTH = { command: 0, fix: 1, setpoint: 2, state: 3, pair: 3 };

/** @param {string} title @param {string} unit @param {number} factor @param {number} least Smallest span of the axis. @param {Partial<Record<Kind, string | Worked>>} columns @returns {Panel} */
function panel(title, unit, factor, least, columns) {
  const traces = Object.entries(columns).map(([kind, column]) => ({ kind: /** @type {Kind} */ (kind), column }));
  return { title, unit, factor, least, digits: ["°", "°/s", "cm"].includes(unit) ? 1 : unit === "PWM" ? 0 : 2, traces };
}

/** @param {string} axis */
const position = (axis) => panel(axis, "m", 1, 0.1, { state: axis, setpoint: `setpoint_${axis}`, fix: `fix_${axis}` });

/** Drones that share a world: distance of each to the nearest one, and positions. A reading for each would be too many. @type {Panel[]} */
const SHARED = [
  { ...panel("separation", "m", 1, 0.2, { state: "separation_m", setpoint: "least_separation_m" }), told: (all) => number(Math.min(...all.map((s) => s.separation_m))) },
  ...["x", "y", "z"].map((axis) => ({ ...panel(axis, "m", 1, 0.1, { state: axis }), told: () => "" })),
  { ...panel("yaw", "°", DEG, 4, { state: "yaw" }), told: () => "" },
  { ...panel("reward", "", 1, 0.1, { state: "reward" }), told: () => "" },
];

/** A row's place. @param {Flight} flight @param {number} row */
const place = (flight, row) => ["x", "y", "z"].map((axis) => flight.get(axis, row));

/** Function of both flights, only while both fly. @param {Flight} b @param {(a: Flight, row: number, other: number) => number} work @returns {Worked} */
function pair(b, work) {
  return (a, row) => {
    const time_s = a.get("t_s", row);
    return a === b || time_s > b.lastTime ? NaN : work(a, row, b.rowAt(time_s));
  };
}

/** A log beside its model: both, and their residual. @param {Flight} model @returns {Panel[]} */
function residuals(model) {
  /** @type {[string[], string, number, number][]} */
  const signals = [[["x", "y", "z"], "m", 1, 0.1], [["vx", "vy"], "m/s", 1, 0.2], [["roll", "pitch", "yaw"], "°", DEG, 4]];
  const all = signals.flatMap(([names, unit, factor, least]) => names.map((name) => ({ name, unit, factor, least })));
  const left = (/** @type {string} */ name) => pair(model, (a, row, other) => a.get(name, row) - model.get(name, other));
  return [
    ...all.map(({ name, unit, factor, least }) => panel(name, unit, factor, least, { state: name })),
    ...all.map(({ name, unit, factor, least }) => panel(`${name}, measured − model`, unit, factor, least / 4, { pair: left(name) })),
  ];
}

/** Two runs on one clock: error of each, difference of the errors, and distance between both. @param {Flight} b @returns {Panel[]} */
function compared(b) {
  return [
    panel("off the set-point", "cm", 100, 2, { state: off_m }),
    panel("off the set-point, A − B", "cm", 100, 2, { pair: pair(b, (a, row, other) => off_m(a, row) - off_m(b, other)) }),
    panel("from A to B", "cm", 100, 2, { pair: pair(b, (a, row, other) => Math.hypot(...place(a, row).map((part, axis) => part - place(b, other)[axis]))) }),
  ];
}

/** @param {(Flight | null)[]} flights The lift is a height or a PWM count, as its size says. @returns {Panel[]} */
export function panels(flights) {
  const [flight, second] = flights.filter((each) => each !== null);
  if (!flight) return [];
  if (second && (flight.header.drones ?? 1) > 1) return SHARED;
  if (second?.header.name) return residuals(second);
  const pwm = Math.max(...flight.series("u_lift").subarray(0, 500)) > 20;
  return [
    ...(second ? compared(second) : []),
    position("x"),
    position("y"),
    position("z"),
    panel("roll", "°", DEG, 4, { state: "roll", command: "u_roll" }),
    panel("pitch", "°", DEG, 4, { state: "pitch", command: "u_pitch" }),
    panel("yaw", "°", DEG, 4, { state: "yaw", setpoint: "setpoint_yaw", fix: "fix_yaw" }),
    panel("yaw rate command", "°/s", DEG, 4, { command: "u_yaw_rate" }),
    pwm ? panel("lift command", "PWM", 1, 1000, { command: "u_lift" }) : panel("lift command", "m", 1, 0.1, { command: "u_lift" }),
    panel("reward", "", 1, 0.1, { state: "reward" }),
  ];
}

/** @param {Flight} flight @param {string | Worked} column @param {number} row */
export function worth(flight, column, row) {
  return typeof column === "string" ? flight.get(column, row) : column(flight, row);
}

/** One trace: null where there is nothing to draw. @param {Flight} flight @param {Trace} trace @param {number} factor @param {number} from First row. */
function values(flight, { kind, column }, factor, from) {
  const list = /** @type {(number | null)[]} */ (new Array(flight.rows - from));
  for (let row = from; row < flight.rows; row += 1) {
    const value = worth(flight, column, row);
    list[row - from] = Number.isFinite(value) && (kind !== "fix" || flight.isNewFix(row)) ? value * factor : null;
  }
  return list;
}

/** @param {Flight} flight @param {number} from */
function times(flight, from) {
  // rounded: equal times of two flights become one point of the axis
  return Array.from({ length: flight.rows - from }, (_, i) => Math.round(flight.get("t_s", from + i) * 1e4) / 1e4);
}

/**
 * The tables of a panel, one per flight that is there: time, then one list per trace; and whose trace each list is.
 * @param {Panel} asked @param {(Flight | null)[]} flights @param {number} since_s Older rows are left out.
 */
export function tables(asked, flights, since_s) {
  const made = /** @type {any[][]} */ ([]);
  const drawn = /** @type {Drawn[]} */ ([]);
  for (const [run, flight] of flights.entries()) {
    if (!flight) continue;
    const from = since_s > flight.firstTime ? flight.rowAt(since_s) : 0;
    made.push([times(flight, from), ...asked.traces.map((trace) => values(flight, trace, asked.factor, from))]);
    drawn.push(...asked.traces.map(({ kind }) => ({ run, kind })));
  }
  return { made, drawn };
}
