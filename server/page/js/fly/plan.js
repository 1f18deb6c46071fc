// The world for a flight by hand, which the page requests from the server: two drones of the same task.

import { perDrone } from "../flight.js";

/** Drones of the world: the pilot's is the one nearer to the viewer, who stands behind it. */
export const AUTOPILOT_DRONE = 0;
export const PILOT_DRONE = 1;
export const SECONDS = 30;
const TICKS_PER_S = 50;

/** A tick is flown without the page when it is late by another tick: a slow browser slows nothing down. */
const DEADLINE_S = 0.04;

/** Options of each task. @type {Record<string, any>} */
const TASK_OPTIONS = {
  formation: { spacing_m: 0.8, roam_m: 0.5, period_s: 20 },
  swap: { radius_m: 1, wait_s: 2 },
};

/** Positions of rings and drones before take-off, the autopilot's first: x, y, z. @type {Record<string, number[][]>} */
const STARTS = {
  formation: [[0.9, 0, 0.8], [0.1, 0, 0.8]],
  swap: [[0.9, 0.43, 0.8], [-0.9, -0.43, 0.8]],
};
const BEFORE = ["t_s", "x", "y", "z", "roll", "pitch", "yaw", "setpoint_x", "setpoint_y", "setpoint_z", "setpoint_yaw", "fix_valid", "flying"];

/** The two drones on the floor below their rings. @param {string} task */
export function beforeTakeOff(task) {
  const rows = STARTS[task].flatMap(([x, y, z]) => [0, x, y, 0, 0, 0, 0, x, y, z, 0, 1, 0]);
  const header = { columns: BEFORE, drones: 2, rows: 1, tick_s: 1 / TICKS_PER_S, marker: [[0, 0, 0]], camera: { fov_deg: 120, offset_m: 0.02 } };
  return perDrone(header, Float32Array.from(rows));
}

/** The lab's rig as `crazyflie fly --sensors lab` has it. */
const CAMERA = { camera: { on: 1 }, camera_latency: { latency_s: 0.05 }, camera_noise: { xy_m: 0.005, z_m: 0.01, yaw_deg: 1 } };
/** Delay of the lab's pictures, here on the way to the vehicle: a pilot feels it without the camera. */
const DELAY = { cmd_delay: { delay_s: 0.05 } };

/**
 * The request for a world.
 * @param {{task: string, camera: boolean, delay: boolean}} chosen
 */
export function worldRequest({ task, camera, delay }) {
  const number = crypto.getRandomValues(new Uint32Array(2));
  return {
    type: "world",
    name: `page-${[...number].map((part) => part.toString(36)).join("-")}`,
    mission: task,
    seed: number[0],
    deadline_s: DEADLINE_S,
    options: {
      drones: 2,
      max_episode_steps: SECONDS * TICKS_PER_S,
      vertical: "height",
      task_options: TASK_OPTIONS[task] ?? {},
      // the autopilot knows of nobody: it keeps to its ring, also where the pilot is in its way
      neighbours: { by: "range", range_m: 0 },
      effects: { ...(camera ? CAMERA : {}), ...(delay ? DELAY : {}) },
    },
  };
}
