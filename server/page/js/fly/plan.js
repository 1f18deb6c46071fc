// What is flown by hand: the world that the page asks the server for, with two drones of the same task.

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

/** The lab's rig as `crazyflie fly --sensors lab` has it. */
const CAMERA = { camera: { on: 1 }, camera_latency: { latency_s: 0.05 }, camera_noise: { xy_m: 0.005, z_m: 0.01, yaw_deg: 1 } };
/** As long as the lab's pictures take, but on the way to the vehicle: it can be felt without the camera. */
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
      effects: { ...(camera ? CAMERA : {}), ...(delay ? DELAY : {}) },
    },
  };
}
