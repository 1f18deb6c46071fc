// The path flown: a line as long as the time that has passed, over a faint one of the whole flight.

import * as THREE from "../../vendor/three/three.module.min.js";
import { LineMaterial } from "../../vendor/three/LineMaterial.js";
import { LineSegments2 } from "../../vendor/three/LineSegments2.js";
import { LineSegmentsGeometry } from "../../vendor/three/LineSegmentsGeometry.js";

/** @typedef {import("../flight.js").Flight} Flight */

export class Trail extends THREE.Group {
  /** @type {Flight | null} */
  #flight = null;
  #dropped = 0;
  #written = 0;
  #past;
  #whole;
  #names;
  #faded;

  /** @param {[string, string, string]} names Columns of the points. @param {{width: number, faded: number}} look Pixels; how much of the sky is in what is still to come. */
  constructor(names, { width, faded }) {
    super();
    this.#names = names;
    this.#faded = faded;
    const line = (/** @type {number} */ linewidth) => {
      // opaque: the joints of transparent pieces would show as beads
      const made = new LineSegments2(new LineSegmentsGeometry(), new LineMaterial({ linewidth }));
      made.frustumCulled = false;
      this.add(made);
      return made;
    };
    this.#whole = line(Math.max(1, width - 1.5));
    this.#past = line(width);
  }

  /** @param {THREE.ColorRepresentation} colour @param {THREE.ColorRepresentation} sky */
  setColour(colour, sky) {
    this.#past.material.color.set(colour);
    this.#whole.material.color.set(colour).lerp(new THREE.Color(sky), this.#faded);
  }

  /** @param {Flight} flight @param {number} row The last row that has passed. */
  update(flight, row) {
    if (flight !== this.#flight) this.#begin(flight);
    if (flight.dropped !== this.#dropped) {
      this.#dropped = flight.dropped;
      this.#written = 0;
    }
    this.#write(flight);
    this.#past.geometry.instanceCount = Math.max(0, Math.min(row, this.#written));
    this.#whole.geometry.instanceCount = this.#written;
    this.#past.visible = this.#past.geometry.instanceCount > 0;
    this.#whole.visible = this.#written > this.#past.geometry.instanceCount;
  }

  /** @param {Flight} flight */
  #begin(flight) {
    const fits = this.#flight?.capacity === flight.capacity;
    this.#flight = flight;
    this.#dropped = flight.dropped;
    this.#written = 0;
    if (fits) return;
    for (const line of [this.#past, this.#whole]) line.geometry.dispose();
    this.#past.geometry = new LineSegmentsGeometry().setPositions(new Float32Array(6 * Math.max(1, flight.capacity)));
    this.#whole.geometry = new LineSegmentsGeometry();
    for (const name of ["instanceStart", "instanceEnd"]) this.#whole.geometry.setAttribute(name, this.#past.geometry.getAttribute(name));
  }

  /** Segments of rows that came since. @param {Flight} flight */
  #write(flight) {
    const buffer = /** @type {THREE.InterleavedBufferAttribute} */ (this.#past.geometry.getAttribute("instanceStart")).data;
    const before = this.#written;
    for (; this.#written < flight.rows - 1; this.#written += 1) {
      for (const [axis, name] of this.#names.entries()) {
        buffer.array[6 * this.#written + axis] = flight.get(name, this.#written);
        buffer.array[6 * this.#written + 3 + axis] = flight.get(name, this.#written + 1);
      }
    }
    if (this.#written !== before) buffer.needsUpdate = true;
  }
}
