// Colours of vehicles: runs A and B have their own, drones that share a world a hue each.

import { colour } from "./dom.js";

/** @typedef {import("./flight.js").Flight} Flight */

/** True for drones of one world, false for flights to be compared. @param {(Flight | null)[]} flights */
export function shareWorld(flights) {
  return flights.some((flight) => (flight?.header.drones ?? 1) > 1);
}

/**
 * @param {number} run @param {number} drones How many share the world; 1 for runs A and B.
 * @returns {{run: string, fix: string, command: string}}
 */
export function runColours(run, drones) {
  if (drones === 1) {
    const name = "ab"[run];
    return { run: colour(`--run-${name}`), fix: colour(`--fix-${name}`), command: colour(`--command-${name}`) };
  }
  // from the blue of run A around the circle
  const own = `hsl(${Math.round(210 + (360 * run) / drones) % 360}, 75%, ${colour("--drone-lightness")})`;
  return { run: own, fix: own, command: own };
}
