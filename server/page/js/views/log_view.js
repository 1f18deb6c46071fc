// A flight log that the visitor drops on the page: it flies beside its model, with what the model leaves over. The server keeps nothing of it.

import { ApiError, replayLog } from "../api.js";
import { Clock } from "../clock.js";
import { byId, lessMotion, make, number } from "../dom.js";
import { logFlights } from "../flight.js";
import { go, here } from "../place.js";
import { failure, notice } from "./notice.js";
import { transport } from "./transport.js";
import { fillVehicles } from "./vehicles.js";

/** @typedef {{grade: "grave" | "warning" | "remark", text: string, cure: string | null}} Finding */

/** The server refuses larger ones, once part of it is sent. */
const MOST_MIB = 16;
const CHOICES = { vehicle: "log-vehicle", horizon_s: "log-horizon", hover_pwm: "log-hover" };
const GRADES = { grave: "bad", warning: "warn", remark: "muted" };
const EMPTY = "Drop a flight log on this page, or choose one.\nCSV, npz, ROS bag, ULog, micro-SD, packed or not.";

export class LogView {
  clock = new Clock();
  #active = false;
  /** @type {File | null} */
  #file = null;
  #anyway = false;
  /** Ends the question before, and the server's work on it. */
  #asked = new AbortController();
  /** @type {import("../flight.js").Flight[]} */
  #flights = [];

  /** @param {import("./display.js").Display} display */
  constructor(display) {
    this.display = display;
    byId("log-file").addEventListener("change", () => this.#take(byId("log-file").files[0]));
    for (const id of Object.values(CHOICES)) byId(id).addEventListener("change", () => this.#ask());
    transport(this.clock, () => this.#active, () => this.display.toggle("split"));
    this.clock.addEventListener("change", () => this.#active && this.display.setTime(this.clock.time_s));
    this.#acceptDrops();
  }

  async enter() {
    this.#active = true;
    this.display.onSeek = (time_s) => this.clock.seek(time_s);
    byId("seeds").hidden = true;
    await fillVehicles(byId("log-vehicle"));
    this.#show(true);
  }

  leave() {
    this.#active = false;
    this.clock.pause();
    this.display.toggle("split", false);
    this.display.say("");
    notice("log", null);
  }

  /** Anywhere on the page. */
  #acceptDrops() {
    const over = (/** @type {boolean} */ is) => document.body.toggleAttribute("data-drop", is);
    document.addEventListener("dragover", (event) => {
      if (!event.dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      over(true);
    });
    document.addEventListener("dragleave", (event) => {
      if (!event.relatedTarget) over(false);
    });
    document.addEventListener("drop", (event) => {
      over(false);
      if (!event.dataTransfer?.files.length) return;
      event.preventDefault();
      byId("log-file").files = event.dataTransfer.files;
      this.#take(event.dataTransfer.files[0]);
    });
  }

  /** @param {File | undefined} file */
  #take(file) {
    if (!file) return;
    this.#file = file;
    this.#anyway = false;
    if (here().view !== "log") go("log");
    this.#ask();
  }

  async #ask() {
    const file = this.#file;
    if (!file) return;
    this.#asked.abort();
    const { signal } = (this.#asked = new AbortController());
    this.clock.pause();
    this.#flights = [];
    byId("log-told").replaceChildren();
    notice("log", null);
    this.display.show([]);
    if (file.size > MOST_MIB << 20) {
      this.#refuse(new ApiError(`${file.name} has ${number(file.size / 2 ** 20, 1)} MiB, expected at most ${MOST_MIB} MiB; gzip makes a log smaller.`, 0));
      return;
    }
    this.display.say(`Reading ${file.name}…`);
    const query = /** @type {Record<string, string>} */ ({ file: file.name });
    for (const [name, id] of Object.entries(CHOICES)) if (byId(id).value) query[name] = byId(id).value;
    if (this.#anyway) query.anyway = "true";
    try {
      const answer = await replayLog(file, query, signal);
      if (signal.aborted) return;
      this.#flights = logFlights(answer);
      const remarks = answer.replay.remarks.map((/** @type {string} */ text) => ({ grade: "remark", text, cure: null }));
      byId("log-told").replaceChildren(fits(answer), told([...answer.findings, ...remarks]));
      this.#show(true);
      if (!lessMotion()) this.clock.play();
    } catch (error) {
      if (!signal.aborted) this.#refuse(error);
    }
  }

  /** @param {unknown} error */
  #refuse(error) {
    this.display.say(EMPTY);
    const findings = error instanceof ApiError ? error.findings : [];
    if (!findings.length) {
      failure("log", error);
      return;
    }
    this.display.say("This log is refused. The reason and its cure are below.");
    const anyway = () => {
      this.#anyway = true;
      this.#ask();
    };
    byId("log-told").replaceChildren(told(findings), make("button", { type: "button", onclick: anyway }, "Replay it all the same"));
  }

  /** @param {boolean} fromStart */
  #show(fromStart) {
    if (!this.#active) return;
    const [measured] = this.#flights;
    this.display.show(this.#flights, { names: ["measured", "model"] });
    this.display.say(measured ? "" : EMPTY);
    byId("toggle-split").hidden = !this.display.stage.splits || !measured;
    this.clock.end_s = measured?.lastTime ?? 0;
    if (fromStart) this.clock.seek(0);
  }
}

/** Faults of the log, and remarks folded below. @param {Finding[]} findings */
function told(findings) {
  const line = (/** @type {Finding} */ { grade, text, cure }) => make("p", {}, make("strong", { class: GRADES[grade] }, `${grade}: `), text, cure ? `; ${cure}` : "", ".");
  const [wrong, remarks] = [false, true].map((is) => findings.filter(({ grade }) => (grade === "remark") === is).map(line));
  const folded = make("details", { hidden: !remarks.length }, make("summary", {}, `${remarks.length} remarks`), ...remarks);
  return make("div", {}, ...wrong, folded);
}

/** Agreement of each signal with the model. @param {any} answer */
function fits({ replay, vehicle, format, columns }) {
  const head = ["signal", "fit", "RMSE", "largest"].map((text) => make("th", { scope: "col" }, text));
  const rows = columns.map((/** @type {string} */ name) => {
    const { unit, fit_percent, rmse, max_error } = replay.signals[name];
    const error = (/** @type {number} */ value) => `${number(value, value < 10 ? 3 : 1)} ${unit === "deg" ? "°" : unit}`;
    const cells = [fit_percent === null ? "–" : `${number(fit_percent, 1)} %`, error(rmse), error(max_error)];
    return make("tr", {}, make("th", { scope: "row" }, name), ...cells.map((cell) => make("td", {}, cell)));
  });
  const caption = `${format} on ${vehicle}, ${replay.vertical} form: measured − model`;
  return make("table", { id: "log-fits" }, make("caption", {}, caption), make("thead", {}, make("tr", {}, ...head)), make("tbody", {}, ...rows));
}
