// The tuner's plots: flights as bands of quantiles, the step on paper, and Bode.

import uPlot from "../../vendor/uplot/uPlot.esm.js";
import { colour, make, onTheme } from "../dom.js";

const FONT = "11px system-ui, sans-serif";
const HEIGHT_PX = 210;
/** An answer beyond twice the step leaves the plot. */
const EDGES = [-1, 3];

/** @typedef {{key: string, title: string, height: number, make: (answer: any) => {data: any[], options: any}}} Plot */

/** A colour of the page with an opacity, for the canvas. @param {string} name @param {string} alpha Two hexadecimal digits. */
const faint = (name, alpha) => colour(name) + alpha;

/** @param {string} name @param {number} [width] @param {number[]} [dash] */
const line = (name, width = 1.75, dash) => ({ stroke: colour(name), width, dash, points: { show: false } });

/** Lies at one value over the whole width. @param {number[]} x @param {number} y */
const level = (x, y) => x.map(() => y);

/** @type {Plot[]} */
const PLOTS = [
  { key: "flights", title: "1000 flights [UNIT] over s: median, half and nine tenths of them", height: 1.5, make: flights },
  { key: "step", title: "Step on paper [share of the step] over s", height: 1.5, make: step },
  { key: "magnitude", title: "Bode: magnitude [dB] over rad/s", height: 1, make: (answer) => bode(answer, "magnitude_db", 0, [-60, 40]) },
  { key: "phase", title: "Bode: phase [°] over rad/s", height: 1, make: (answer) => bode(answer, "phase_deg", -180, [-360, 0]) },
];

/** @param {any} answer */
function flights({ band, report }) {
  const factor = report.loop === "yaw" ? 180 / Math.PI : 1;
  const scaled = (/** @type {number[]} */ values) => values.map((value) => value * factor);
  const target = scaled(band.target);
  const [start, end] = [target[0], target[target.length - 1]];
  const size = Math.abs(end - start);
  const [low, q25, median, q75, high] = band.quantiles.map(scaled);
  const hidden = { width: 0, points: { show: false } };
  return {
    data: [band.t_s, low, high, q25, q75, median, target],
    options: {
      series: [{}, hidden, hidden, hidden, hidden, line("--run-a"), line("--setpoint", 1.25, [5, 4])],
      bands: [
        { series: [2, 1], fill: faint("--run-a", "2e") },
        { series: [4, 3], fill: faint("--run-a", "5a") },
      ],
      scales: { x: { time: false }, y: { range: () => [Math.min(start, end) - size, Math.max(start, end) + size] } },
    },
  };
}

/** @param {any} answer */
function step({ report }) {
  const { t_s, value } = report.step;
  return {
    data: [t_s, value, level(t_s, 1)],
    options: {
      series: [{}, line("--run-a"), line("--setpoint", 1.25, [5, 4])],
      scales: { x: { time: false, range: () => [0, 10] }, y: { range: (/** @type {any} */ _plot, /** @type {number} */ low, /** @type {number} */ high) => [Math.max(low - 0.1, EDGES[0]), Math.min(high + 0.1, EDGES[1])] } },
    },
  };
}

/** @param {any} answer @param {string} part @param {number} critical @param {number[]} range */
function bode({ report }, part, critical, range) {
  const { omega_radps, [part]: values } = report.frequency;
  return {
    data: [omega_radps, values, level(omega_radps, critical)],
    options: {
      series: [{}, line("--run-a"), line("--bad", 1.25, [5, 4])],
      // to the ends of the data, not to the next power of ten
      scales: { x: { time: false, distr: 3, range: (/** @type {any} */ _plot, /** @type {number} */ low, /** @type {number} */ high) => [low, high] }, y: { range: () => range } },
    },
  };
}

export class LoopPlots {
  /** @type {{plot: any, box: HTMLElement, height: number}[]} */
  #drawn = [];
  /** @type {any} */
  #answer = null;
  #loop = "";

  /** @param {HTMLElement} host */
  constructor(host) {
    this.host = host;
    new ResizeObserver(() => this.#resize()).observe(host);
    onTheme(() => this.#build());
  }

  /** @param {any} answer */
  show(answer) {
    this.#answer = answer;
    // the scales are the loop's own; otherwise only the numbers are new
    if (this.#loop !== answer.report.loop || !this.#drawn.length) {
      this.#loop = answer.report.loop;
      this.#build();
      return;
    }
    for (const [i, { plot }] of this.#drawn.entries()) plot.setData(PLOTS[i].make(answer).data);
  }

  #build() {
    if (!this.#answer) return;
    for (const { plot } of this.#drawn) plot.destroy();
    this.host.replaceChildren();
    this.#drawn = PLOTS.map((each) => this.#plot(each));
  }

  /** @param {Plot} each */
  #plot({ key, title, height, make: drawing }) {
    const box = make("figure", { class: "strip", "data-plot": key }, make("figcaption", {}, make("span", {}, title.replace("UNIT", this.#loop === "yaw" ? "rad" : "m"))));
    this.host.append(box);
    const axis = { stroke: colour("--muted"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false }, font: FONT };
    const { data, options } = drawing(this.#answer);
    const words = (/** @type {any} */ _plot, /** @type {(number | null)[]} */ ticks) => ticks.map((tick) => (tick === null ? "" : String(tick)));
    const all = {
      ...this.#size(box, height),
      legend: { show: false },
      cursor: { show: false },
      padding: [8, 14, 0, 0],
      axes: [{ ...axis, size: 22, gap: 3, space: 50, values: words }, { ...axis, size: 46, gap: 4, space: 28, values: words }],
      ...options,
    };
    return { plot: new uPlot(all, data, box), box, height };
  }

  /** @param {HTMLElement} box @param {number} height */
  #size(box, height) {
    return { width: Math.max(120, box.clientWidth), height: Math.round(HEIGHT_PX * height) };
  }

  #resize() {
    for (const { plot, box, height } of this.#drawn) {
      const size = this.#size(box, height);
      if (size.width !== plot.width) plot.setSize(size);
    }
  }
}
