// Parts of flights that are drawn, and their style.

import { lessMotion } from "../dom.js";

/**
 * `single`: which drone is singled out; `pilot`: which one is flown by hand: arrows lead to its set-point, and walls are seen;
 * `ownRings`: set-points have the colours of their drones.
 * @typedef {{vehicleScale: number, cone: boolean, spin: boolean, follow: boolean, split: boolean, ownRings: boolean, single: number | null, pilot: number | null}} Look
 */

/** @returns {Look} */
export const plainLook = () => ({ vehicleScale: 2, cone: true, spin: !lessMotion(), follow: false, split: false, ownRings: false, single: null, pilot: null });
