// Strip charts under the 3D view, with a line that shows the time.

import uPlot from "../../vendor/uplot/uPlot.esm.js";
import { runColours } from "../colours.js";
import { colour, make, number, onTheme } from "../dom.js";
import { DEPTH, panels, tables, worth } from "./panels.js";

/** @typedef {import("../flight.js").Flight} Flight */
/** @typedef {import("./panels.js").Panel} Panel */
/** @typedef {import("./panels.js").Drawn} Drawn */
/** @typedef {{panel: Panel, plot: any, line: HTMLElement, readout: HTMLElement, box: HTMLElement}} Strip */

/** Visible part of a live flight. */
export const WINDOW_S = 20;
const FONT = "11px system-ui, sans-serif";

/** @param {Drawn} drawn @param {number} drones That share a world. */
function look({ run, kind }, drones) {
  const own = runColours(run, drones);
  if (kind === "setpoint") return { stroke: colour("--setpoint"), width: 1.25, dash: [5, 4] };
  if (kind === "pair") return { stroke: colour("--text"), width: 1.25 };
  if (kind === "command") return { stroke: own.command, width: 1 };
  if (kind === "fix") return { width: 0, paths: () => null, points: { show: true, size: 3, width: 0, fill: own.fix } };
  return { stroke: own.run, width: 1.75 };
}

/** Room above and below, and never a span so small that noise looks like motion. @param {number} least */
function range(least) {
  return (/** @type {any} */ _plot, /** @type {number | null} */ low, /** @type {number | null} */ high) => {
    if (low === null || high === null) return [0, least];
    const span = Math.max(least, 1.12 * (high - low));
    const middle = (low + high) / 2;
    return [middle - span / 2, middle + span / 2];
  };
}

export class Charts {
  /** @type {Strip[]} */
  #strips = [];
  /** @type {(Flight | null)[]} */
  #flights = [];
  #live = false;
  #time_s = 0;

  /** @param {HTMLElement} host @param {(time_s: number) => void} onSeek */
  constructor(host, onSeek) {
    this.host = host;
    this.onSeek = onSeek;
    new ResizeObserver(() => this.#resize()).observe(host);
    onTheme(() => this.show(this.#flights, this.#live));
  }

  /** @param {(Flight | null)[]} flights @param {boolean} live Shows the newest seconds only. */
  show(flights, live) {
    for (const { plot } of this.#strips) plot.destroy();
    this.#flights = flights;
    this.#live = live;
    this.host.replaceChildren();
    this.#strips = panels(flights).map((panel) => this.#strip(panel));
    this.setTime(this.#time_s);
  }

  /** Takes in rows that came since, or the next episode of what is shown. @param {(Flight | null)[]} flights */
  refresh(flights) {
    this.#flights = flights;
    for (const { panel, plot } of this.#strips) plot.setData(this.#data(panel).data);
    this.setTime(this.#time_s);
  }

  /** @param {number} time_s */
  setTime(time_s) {
    this.#time_s = time_s;
    for (const strip of this.#strips) {
      const left = strip.plot.valToPos(time_s, "x");
      strip.line.style.transform = `translateX(${Math.round(left)}px)`;
      strip.line.hidden = this.#live || !Number.isFinite(left);
      strip.readout.textContent = this.#reading(strip.panel);
    }
  }

  /** The values at the time that is shown. @param {Panel} panel */
  #reading({ traces, factor, digits, told: say }) {
    if (say) return say(this.#flights.flatMap((flight) => flight?.at(this.#time_s) ?? []));
    const values = this.#flights.flatMap((flight) => (flight ? [worth(flight, traces[0].column, flight.rowAt(this.#time_s)) * factor] : []));
    return values.filter((value) => traces[0].kind !== "pair" || Number.isFinite(value)).map((value) => number(value, digits)).join(" | ");
  }

  /** @param {Panel} panel */
  #data(panel) {
    const newest = Math.max(...this.#flights.map((flight) => flight?.lastTime ?? 0));
    const { made, drawn } = tables(panel, this.#flights, this.#live ? newest - WINDOW_S : -Infinity);
    const [times, ...columns] = made.length > 1 ? uPlot.join(made) : made[0];
    const order = [...drawn.keys()].sort((a, b) => DEPTH[drawn[a].kind] - DEPTH[drawn[b].kind]);
    return { data: [times, ...order.map((i) => columns[i])], drawn: order.map((i) => drawn[i]) };
  }

  /** @param {Panel} panel @returns {Strip} */
  #strip(panel) {
    const { data, drawn } = this.#data(panel);
    const readout = make("span", { class: "reading" });
    const unit = panel.unit ? ` [${panel.unit}]` : "";
    const box = make("figure", { class: "strip" }, make("figcaption", {}, make("span", {}, panel.title + unit), readout));
    this.host.append(box);
    const axis = { stroke: colour("--muted"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false }, font: FONT };
    const drones = this.#flights.find((flight) => flight)?.header.drones ?? 1;
    const series = drawn.map((each) => ({ ...{ points: { show: false } }, ...look(each, drones), scale: "y" }));
    const options = {
      ...this.#size(box),
      legend: { show: false },
      cursor: { show: false },
      padding: [8, 14, 0, 0],
      scales: { x: { time: false }, y: { range: range(panel.least) } },
      axes: [{ ...axis, size: 20, gap: 2, space: 60 }, { ...axis, scale: "y", size: 46, gap: 4, space: 24, values: (/** @type {any} */ _plot, /** @type {number[]} */ ticks) => ticks.map(String) }],
      series: [{}, ...series],
    };
    const plot = new uPlot(options, data, box);
    const line = make("div", { class: "now" });
    plot.over.append(line);
    this.#seekable(plot);
    return { panel, plot, line, readout, box };
  }

  /** A press or a drag on a chart goes to that time. @param {any} plot */
  #seekable(plot) {
    const seek = (/** @type {PointerEvent} */ event) => {
      if (this.#live || !(event.buttons & 1)) return;
      this.onSeek(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
    };
    plot.over.addEventListener("pointerdown", seek);
    plot.over.addEventListener("pointermove", seek);
  }

  /** @param {HTMLElement} box */
  #size(box) {
    return { width: Math.max(120, box.clientWidth), height: 96 };
  }

  #resize() {
    for (const { plot, box } of this.#strips) {
      const size = this.#size(box);
      if (size.width !== plot.width) plot.setSize(size);
    }
    this.setTime(this.#time_s);
  }
}
