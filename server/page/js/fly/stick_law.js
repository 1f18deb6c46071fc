// From sticks to an action: four numbers from -1 to 1 for roll, pitch, yaw rate and height.

/** @typedef {import("./controls.js").Sticks} Sticks */
/** @typedef {{tilt_max_rad: number, yaw_rate_max_radps: number, lift_max: number, yaw_sign: number}} Interface */

const GRAVITY_MPS2 = 9.81;
const TICK_S = 0.02;
/** Commands of a stick at its end. */
const SPEED_MPS = 0.7;
const TILT = 0.6;
const TURN_RADPS = 1.5;
const RISE_MPS = 0.5;
/** Action for each metre per second that the speed is off: slower than attitude and camera, so that it does not swing. */
const GAIN_PER_MPS = 0.6;
/** Gain of the correction of the speed predicted from the tilt by a new camera fix. */
const CORRECTION = 0.25;
/** Places of the 24 numbers of an observation, see docs/tasks.md. */
const FIX_X = 0;
const FIX_YAW = 3;
const FIX_AGE = 4;
const FIX_VALID = 5;
const ROLL = 6;
const SETPOINT_Z = 18;

export class StickLaw {
  #speed_mps = [0, 0];
  /** The newest fix: x, y and when it was captured. @type {number[] | null} */
  #fix = null;
  #tick;
  #yaw_rad = 0;
  #height_m;

  /**
   * @param {Interface} limits @param {number[]} observation The first one. @param {number} tick Of that observation.
   * @param {"speed" | "tilt"} keys What a stick sets.
   */
  constructor(limits, observation, tick, keys) {
    this.limits = limits;
    this.keys = keys;
    // a flight begins near its set-point's height
    this.#height_m = observation[SETPOINT_Z];
    this.#tick = tick;
    this.see(observation, tick);
  }

  /** Takes in what the drone measured. @param {number[]} observation @param {number} tick There are ticks without an answer: those that were flown without us. */
  see(observation, tick) {
    const passed_s = TICK_S * (tick - this.#tick);
    this.#tick = tick;
    const [roll, pitch] = observation.slice(ROLL, ROLL + 2);
    const [ahead, left] = [GRAVITY_MPS2 * pitch, -GRAVITY_MPS2 * roll];
    const push = this.#toRoom(ahead, left);
    this.#speed_mps = this.#speed_mps.map((speed, axis) => speed + passed_s * push[axis]);
    if (observation[FIX_VALID] > 0.5) this.#correct(observation);
  }

  /** @param {number[]} observation */
  #correct(observation) {
    this.#yaw_rad = observation[FIX_YAW];
    const [x, y] = observation.slice(FIX_X, FIX_X + 2);
    const captured_s = TICK_S * this.#tick - observation[FIX_AGE];
    const before = this.#fix;
    if (before && captured_s - before[2] < TICK_S / 2) return;
    this.#fix = [x, y, captured_s];
    if (!before) return;
    const passed_s = captured_s - before[2];
    const seen = [(x - before[0]) / passed_s, (y - before[1]) / passed_s];
    this.#speed_mps = this.#speed_mps.map((speed, axis) => speed + CORRECTION * (seen[axis] - speed));
  }

  /** @param {Sticks} sticks @returns {number[]} */
  action(sticks) {
    const { yaw_rate_max_radps, yaw_sign, lift_max } = this.limits;
    this.#height_m = Math.max(0, Math.min(lift_max, this.#height_m + RISE_MPS * TICK_S * sticks.rise));
    const [ahead, left] = this.keys === "tilt" ? [TILT * sticks.forward, TILT * sticks.left] : this.#towards(sticks);
    const turn = (yaw_sign * TURN_RADPS * sticks.turn) / yaw_rate_max_radps;
    // positive roll accelerates to the right
    return [-left, ahead, turn, (2 * this.#height_m) / lift_max - 1].map((number) => Math.max(-1, Math.min(1, number)));
  }

  /** Tilt ahead and to the left that brings the speed to what the sticks ask for. @param {Sticks} sticks */
  #towards({ forward, left }) {
    const [cos, sin] = [Math.cos(this.#yaw_rad), Math.sin(this.#yaw_rad)];
    const [vx, vy] = this.#speed_mps;
    return [GAIN_PER_MPS * (SPEED_MPS * forward - (cos * vx + sin * vy)), GAIN_PER_MPS * (SPEED_MPS * left - (cos * vy - sin * vx))];
  }

  /** From ahead and left to the room's x and y. @param {number} ahead @param {number} left */
  #toRoom(ahead, left) {
    const [cos, sin] = [Math.cos(this.#yaw_rad), Math.sin(this.#yaw_rad)];
    return [cos * ahead - sin * left, sin * ahead + cos * left];
  }
}
