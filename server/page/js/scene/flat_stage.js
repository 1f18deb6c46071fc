// The room from above, where the browser has no WebGL: paths, vehicles with their headings and heights, set-points, plates.

import { runColours } from "../colours.js";
import { colour, make, number, onTheme } from "../dom.js";
import { ROOM_M } from "./room.js";
import { plainLook } from "./look.js";

/** @typedef {import("../flight.js").Flight} Flight */

/** Seen around what flies. */
const MARGIN_M = 0.3;
/** Seen in any case, to each side of the marker. */
const LEAST_M = 0.5;
const PLATE_M = 0.197;
const RING_M = 0.055;
const VEHICLE_M = 0.06;

/** Replaces a `Stage` without WebGL, with the same methods. */
export class FlatStage {
  /** There is one view only. */
  splits = false;
  look = plainLook();
  canvas = make("canvas", { tabIndex: 0, role: "img", "aria-label": "The flight from above; its numbers are in the table beside it" });
  /** @type {(Flight | null)[]} */
  #flights = [];
  /** Left, lower, right and upper edge of what is seen. */
  #seen = [0, 0, 0, 0];
  #time_s = 0;
  #due = false;

  /** @param {HTMLElement} host */
  constructor(host) {
    this.host = host;
    host.prepend(this.canvas, make("p", { id: "flat" }, "From above: this browser has no WebGL for a 3D view."));
    this.pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    new ResizeObserver(() => this.#request()).observe(host);
    onTheme(() => this.#request());
  }

  /** @param {(Flight | null)[]} flights */
  show(flights) {
    this.#flights = flights;
    this.home();
  }

  /** Zooms to the whole path of every flight. */
  home() {
    const edges = [-LEAST_M, -LEAST_M, LEAST_M, LEAST_M];
    for (const flight of this.#flights) {
      for (let row = 0; flight && row < flight.rows; row += 1) this.#reach(edges, flight, row);
    }
    this.#seen = edges;
    this.#request();
  }

  /** @param {number[]} edges @param {Flight} flight @param {number} row */
  #reach(edges, flight, row) {
    for (const [axis, name] of ["x", "y"].entries()) {
      const place = flight.get(name, row);
      edges[axis] = Math.min(edges[axis], place);
      edges[2 + axis] = Math.max(edges[2 + axis], place);
    }
  }

  /** @param {number} time_s */
  setTime(time_s) {
    this.#time_s = time_s;
    // live flights go on
    for (const flight of this.#flights) if (flight?.rows) this.#reach(this.#seen, flight, flight.rowAt(time_s));
    this.#request();
  }

  /** @param {Partial<import("./look.js").Look>} look */
  setLook(look) {
    Object.assign(this.look, look);
    this.#request();
  }

  behind() {
    this.home();
  }

  #request() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => {
      this.#due = false;
      this.#draw();
    });
  }

  #draw() {
    const { clientWidth: width, clientHeight: height } = this.host;
    const { pen } = this;
    Object.assign(this.canvas, { width, height });
    const [left, lower, right, upper] = this.#seen;
    const scale = Math.min(width / (right - left + 2 * MARGIN_M), height / (upper - lower + 2 * MARGIN_M));
    // x to the right and y up, as on paper
    pen.setTransform(scale, 0, 0, -scale, (width - scale * (left + right)) / 2, (height + scale * (lower + upper)) / 2);
    pen.lineJoin = "round";
    pen.fillStyle = colour("--floor");
    pen.fillRect(-ROOM_M.x / 2, -ROOM_M.y / 2, ROOM_M.x, ROOM_M.y);
    pen.lineWidth = 2 / scale;
    pen.strokeStyle = colour("--edge");
    pen.strokeRect(-ROOM_M.x / 2, -ROOM_M.y / 2, ROOM_M.x, ROOM_M.y);
    for (const [x, y] of this.#flights.find(Boolean)?.header.marker ?? [[0, 0]]) pen.strokeRect(x - PLATE_M / 2, y - PLATE_M / 2, PLATE_M, PLATE_M);
    for (const [i, flight] of this.#flights.entries()) {
      const { single } = this.look;
      if (flight?.rows && (single === null || single === i)) this.#run(flight, runColours(i, flight.header.drones ?? 1).run, scale);
    }
  }

  /** @param {Flight} flight @param {string} own @param {number} scale */
  #run(flight, own, scale) {
    const { pen } = this;
    pen.lineWidth = 2 / scale;
    const state = /** @type {import("../flight.js").Row} */ (flight.at(this.#time_s));
    pen.strokeStyle = pen.fillStyle = own;
    pen.beginPath();
    for (let row = 0, last = flight.rowAt(this.#time_s); row <= last; row += 1) pen.lineTo(flight.get("x", row), flight.get("y", row));
    pen.stroke();
    const size = VEHICLE_M * this.look.vehicleScale;
    pen.lineWidth = 4 / scale;
    this.#circle(state.x, state.y, size / 2);
    pen.fill();
    pen.beginPath();
    pen.moveTo(state.x, state.y);
    pen.lineTo(state.x + size * Math.cos(state.yaw), state.y + size * Math.sin(state.yaw));
    pen.stroke();
    pen.strokeStyle = this.look.ownRings ? own : colour("--setpoint");
    pen.lineWidth = 2 / scale;
    if (Number.isFinite(state.setpoint_x + state.setpoint_y)) {
      this.#circle(state.setpoint_x, state.setpoint_y, RING_M);
      pen.stroke();
    }
    pen.save();
    pen.translate(state.x + size, state.y + size);
    pen.scale(1 / scale, -1 / scale);
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = colour("--text");
    pen.fillText(`${number(state.z)} m`, 0, 0);
    pen.restore();
  }

  /** @param {number} x @param {number} y @param {number} radius */
  #circle(x, y, radius) {
    this.pen.beginPath();
    this.pen.arc(x, y, radius, 0, 2 * Math.PI);
  }
}
