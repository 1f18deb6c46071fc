// A flight as rows of numbers: the frames that the server sends, and the state at a time.

/**
 * @typedef {object} Header
 * @property {string[]} columns
 * @property {number} [drones] Rows for each moment: drones that share a world.
 * @property {number} rows
 * @property {number} tick_s
 * @property {number[][]} marker Centres of the plates on the floor.
 * @property {{fov_deg: number, offset_m: number}} camera
 * @property {string} [end] How the episode ended.
 * @property {string} [name] What flew, where that is neither run A nor run B: the measured flight of a log, or its model's.
 * @property {any} [showcase] Of the flight that loops: whose attempt it is; null if nobody's.
 *
 * @typedef {Record<string, number>} Row One value per column.
 */

/** Angles are interpolated the short way round. */
const ANGLES = new Set(["roll", "pitch", "yaw", "setpoint_yaw", "fix_yaw"]);
/** These hold until the next row. */
const HELD = new Set(["fix_x", "fix_y", "fix_z", "fix_yaw", "fix_valid", "u_roll", "u_pitch", "u_yaw_rate", "u_lift", "reward", "flying"]);

/** A difference of angles in [-pi, pi). @param {number} angle */
export function wrapped(angle) {
  return angle - 2 * Math.PI * Math.floor((angle + Math.PI) / (2 * Math.PI));
}

/** Distance of a vehicle to its set-point. @param {Flight} flight @param {number} row */
export function off_m(flight, row) {
  return Math.hypot(...["x", "y", "z"].map((axis) => flight.get(axis, row) - flight.get(`setpoint_${axis}`, row)));
}

/**
 * Splits a frame (u32 length, JSON header, padding to 4 bytes, rows of f32) into its parts.
 * @param {ArrayBuffer} buffer
 * @returns {{header: Header, values: Float32Array}}
 */
export function parseFrame(buffer) {
  if (buffer.byteLength < 4) throw new Error("a frame of flight data is shorter than its length field");
  const length = new DataView(buffer).getUint32(0, true);
  const start = 4 + Math.ceil(length / 4) * 4;
  if (start > buffer.byteLength) throw new Error("a frame of flight data ends within its header");
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  if (!Array.isArray(header.columns)) throw new Error("the header of the flight data names no columns");
  return { header, values: new Float32Array(buffer, start) };
}

/**
 * A flight for each drone of a header; of every moment there is a row of each.
 * @param {Header} header @param {Float32Array} values @param {number} [capacity] Rows to keep of each; all, unless given.
 */
export function perDrone(header, values, capacity) {
  const drones = header.drones ?? 1;
  const width = header.columns.length;
  if (drones === 1) return [new Flight(header, values, capacity)];
  return Array.from({ length: drones }, (_, drone) => {
    const own = new Float32Array(Math.floor(values.length / drones / width) * width);
    for (let to = 0; to < own.length; to += width) {
      const from = to * drones + drone * width;
      own.set(values.subarray(from, from + width), to);
    }
    return new Flight(header, own, capacity);
  });
}

/** The measured flight of a log, and its model's. @param {any} answer Of the server. @returns {Flight[]} */
export function logFlights({ columns, tick_s, measured, model }) {
  const flight = (/** @type {string} */ name, /** @type {number[][]} */ rows) => {
    const header = { columns: ["t_s", ...columns], rows: rows.length, tick_s, marker: [], camera: { fov_deg: 0, offset_m: 0 }, name };
    return new Flight(header, Float32Array.from(rows.flatMap((row, tick) => [tick * tick_s, ...row])));
  };
  return [flight("measured", measured), flight("model", model)];
}

/** Rows in time order. A live flight forgets its oldest rows; a stored one keeps all. */
export class Flight {
  /** @param {Header} header @param {Float32Array} values @param {number} [capacity] Rows to keep; all, unless given. */
  constructor(header, values, capacity) {
    this.header = header;
    this.width = header.columns.length;
    if (values.length % this.width !== 0) throw new Error(`flight data of ${values.length} numbers is not made of rows of ${this.width}`);
    /** @type {Map<string, number>} */
    this.column = new Map(header.columns.map((name, i) => [name, i]));
    this.capacity = capacity ?? values.length / this.width;
    this.values = new Float32Array(this.capacity * this.width);
    this.rows = 0;
    /** Rows ever forgotten: row i was the row `dropped + i` of the flight. */
    this.dropped = 0;
    this.append(values);
  }

  /** @param {Float32Array} values Whole rows. */
  append(values) {
    for (let from = 0; from + this.width <= values.length; from += this.width) {
      if (this.rows === this.capacity) this.#forget();
      this.values.set(values.subarray(from, from + this.width), this.rows * this.width);
      this.rows += 1;
    }
  }

  /** Makes room: a quarter at once, so that it is seldom. */
  #forget() {
    const gone = Math.max(1, this.capacity >> 2);
    this.values.copyWithin(0, gone * this.width, this.rows * this.width);
    this.rows -= gone;
    this.dropped += gone;
  }

  /** @param {string} name @param {number} row */
  get(name, row) {
    const column = this.column.get(name);
    return column === undefined ? NaN : this.values[row * this.width + column];
  }

  /** True if there is such a column. @param {string} name */
  has(name) {
    return this.column.has(name);
  }

  /** @param {string} name @param {number} row @param {number} value */
  set(name, row, value) {
    const column = this.column.get(name);
    if (column !== undefined) this.values[row * this.width + column] = value;
  }

  /** @param {string} name @returns {Float64Array} */
  series(name) {
    return Float64Array.from({ length: this.rows }, (_, row) => this.get(name, row));
  }

  get firstTime() {
    return this.rows ? this.get("t_s", 0) : 0;
  }

  get lastTime() {
    return this.rows ? this.get("t_s", this.rows - 1) : 0;
  }

  /** The last row that is not after `time_s`; 0 before the first. @param {number} time_s */
  rowAt(time_s) {
    let low = 0;
    let high = this.rows - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.get("t_s", middle) <= time_s + 1e-6) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** The state at a time, between rows interpolated. @param {number} time_s @returns {Row | null} */
  at(time_s) {
    if (!this.rows) return null;
    const row = this.rowAt(time_s);
    const next = Math.min(row + 1, this.rows - 1);
    const span = this.get("t_s", next) - this.get("t_s", row);
    const share = span > 0 ? Math.min(1, Math.max(0, (time_s - this.get("t_s", row)) / span)) : 0;
    /** @type {Row} */
    const state = {};
    for (const name of this.header.columns) {
      const [a, b] = [this.get(name, row), this.get(name, next)];
      const change = ANGLES.has(name) ? wrapped(b - a) : b - a;
      state[name] = share === 0 || HELD.has(name) ? a : a + share * change;
    }
    return state;
  }

  /** True if a row has a camera fix that the row before did not have. @param {number} row */
  isNewFix(row) {
    if (!(this.get("fix_valid", row) > 0.5)) return false;
    if (row === 0) return true;
    return ["fix_x", "fix_y", "fix_z", "fix_yaw"].some((name) => this.get(name, row) !== this.get(name, row - 1));
  }
}
