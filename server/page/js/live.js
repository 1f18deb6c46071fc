// The live socket: follows one session, and comes back by itself when the server was gone.

import { parseFrame, perDrone } from "./flight.js";

/** Rows that are kept: two minutes at the server's thirty per second. */
const CAPACITY = 3600;
const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8000;

/** Flights without a row yet. @param {import("./flight.js").Header} header */
function fresh(header) {
  return perDrone(header, new Float32Array(0), CAPACITY);
}

/**
 * Says `flight` when rows came, `state` when the connection changed (see `connected`), `trouble` with a message in `detail`.
 */
export class Live extends EventTarget {
  /** One for each drone of the world. @type {Flight[]} */
  flights = [];
  connected = false;
  /** @type {string | null} */
  #session = null;
  /** @type {WebSocket | null} */
  #socket = null;
  #env = 0;
  #headerDue = true;
  #wait_ms = FIRST_WAIT_MS;
  #timer = 0;

  /** @param {string | null} session Nobody, if null. @param {number} [env] Which of its environments. */
  watch(session, env = 0) {
    this.#session = session;
    this.#env = env;
    this.flights = [];
    clearTimeout(this.#timer);
    this.#socket?.close();
    this.#socket = null;
    if (session !== null) this.#open();
  }

  #open() {
    const url = new URL("live", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.hash = "";
    const socket = new WebSocket(url, "crazyflie.live.v1");
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onopen = () => {
      this.#wait_ms = FIRST_WAIT_MS;
      this.#headerDue = true;
      socket.send(JSON.stringify({ watch: this.#session, env: this.#env }));
      this.#setConnected(true);
    };
    socket.onmessage = (message) => {
      if (socket === this.#socket) this.#take(message.data);
    };
    socket.onclose = () => {
      if (socket !== this.#socket) return;
      this.#socket = null;
      this.#setConnected(false);
      this.#timer = window.setTimeout(() => this.#open(), this.#wait_ms);
      this.#wait_ms = Math.min(LONGEST_WAIT_MS, 2 * this.#wait_ms);
    };
  }

  /** @param {ArrayBuffer | string} data */
  #take(data) {
    try {
      if (typeof data === "string") this.#said(JSON.parse(data));
      else if (this.#headerDue) this.#begin(data);
      else this.#rows(new Float32Array(data));
    } catch (error) {
      this.#trouble(String(error instanceof Error ? error.message : error));
    }
  }

  /** @param {{message?: string}} said */
  #said(said) {
    if (said.message) this.#trouble(said.message);
  }

  /** @param {ArrayBuffer} frame */
  #begin(frame) {
    const { header, values } = parseFrame(frame);
    this.flights = fresh(header);
    this.#headerDue = false;
    this.#rows(values);
  }

  /** @param {Float32Array} values */
  #rows(values) {
    const [first] = this.flights;
    if (!first || !values.length) return;
    // a new episode begins: its time starts again
    if (first.rows && values[0] < first.lastTime) this.flights = fresh(first.header);
    for (let from = 0; from < values.length; from += first.width) {
      this.flights[(from / first.width) % this.flights.length].append(values.subarray(from, from + first.width));
    }
    this.dispatchEvent(new Event("flight"));
  }

  /** @param {boolean} connected */
  #setConnected(connected) {
    this.connected = connected;
    this.dispatchEvent(new Event("state"));
  }

  /** @param {string} message */
  #trouble(message) {
    this.dispatchEvent(new CustomEvent("trouble", { detail: message }));
  }
}
