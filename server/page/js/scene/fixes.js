// Camera fixes of the last seconds: a dot for each.

import * as THREE from "../../vendor/three/three.module.min.js";

/** @typedef {import("../flight.js").Flight} Flight */

const SHOWN_S = 4;
const SIZE_M = 0.016;

/** A round dot. */
function dot() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 32;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.fillStyle = "#fff";
  context.arc(16, 16, 14, 0, 2 * Math.PI);
  context.fill();
  return new THREE.CanvasTexture(canvas);
}

export class Fixes extends THREE.Points {
  /** @type {Flight | null} */
  #flight = null;
  #dropped = 0;
  #scanned = 0;
  /** Time of each fix that is in the buffer. */
  #times = /** @type {number[]} */ ([]);

  constructor() {
    super(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: SIZE_M, map: dot(), transparent: true, opacity: 0.9, depthWrite: false, alphaTest: 0.3 }));
    this.frustumCulled = false;
  }

  /** @param {THREE.ColorRepresentation} colour */
  setColour(colour) {
    this.material.color.set(colour);
  }

  /** @param {Flight} flight @param {number} time_s */
  update(flight, time_s) {
    if (flight !== this.#flight || flight.dropped !== this.#dropped) this.#begin(flight);
    this.#scan(flight);
    const count = this.#times.findLastIndex((t) => t <= time_s + 1e-6) + 1;
    const first = this.#times.findIndex((t) => t > time_s - SHOWN_S);
    this.visible = first >= 0 && count > first;
    this.geometry.setDrawRange(Math.max(0, first), Math.max(0, count - first));
  }

  /** @param {Flight} flight */
  #begin(flight) {
    if (flight.capacity !== this.#flight?.capacity) {
      this.geometry.dispose();
      this.geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * Math.max(1, flight.capacity)), 3));
    }
    this.#flight = flight;
    this.#dropped = flight.dropped;
    this.#scanned = 0;
    this.#times = [];
  }

  /** Fixes of rows that came since. @param {Flight} flight */
  #scan(flight) {
    const points = /** @type {THREE.BufferAttribute} */ (this.geometry.getAttribute("position"));
    for (; this.#scanned < flight.rows; this.#scanned += 1) {
      const row = this.#scanned;
      if (!flight.isNewFix(row)) continue;
      points.setXYZ(this.#times.length, flight.get("fix_x", row), flight.get("fix_y", row), flight.get("fix_z", row));
      points.needsUpdate = true;
      this.#times.push(flight.get("t_s", row));
    }
  }
}
