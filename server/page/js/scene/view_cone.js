// View of the camera under the vehicle: the edges of its picture, and its footprint on the floor. Faces between them would hide flights.

import * as THREE from "../../vendor/three/three.module.min.js";

/** The thesis's picture is 720 x 480 pixels; its view angle is measured across the diagonal. */
const [WIDE, HIGH] = [720 / Math.hypot(720, 480), 480 / Math.hypot(720, 480)];
/** Edges that do not meet the floor sooner end here. */
const LONGEST_M = 3;
const CORNERS = [[1, 1], [1, -1], [-1, -1], [-1, 1]];

export class ViewCone extends THREE.Group {
  #points = new THREE.BufferAttribute(new Float32Array(5 * 3), 3);
  #lines = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.6 });
  #foot = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.08, side: THREE.DoubleSide, depthWrite: false, polygonOffset: true, polygonOffsetFactor: -2 });
  #direction = new THREE.Vector3();
  #lens = new THREE.Vector3();

  constructor() {
    super();
    const shape = (/** @type {number[]} */ index) => {
      const geometry = new THREE.BufferGeometry().setAttribute("position", this.#points);
      return geometry.setIndex(index);
    };
    this.add(
      new THREE.LineSegments(shape([0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1]), this.#lines),
      new THREE.Mesh(shape([1, 2, 3, 1, 3, 4]), this.#foot),
    );
    for (const child of this.children) child.frustumCulled = false;
  }

  /** @param {THREE.Vector3} position @param {THREE.Quaternion} attitude @param {{fov_deg: number, offset_m: number}} camera */
  update(position, attitude, camera) {
    const half = Math.tan((Math.min(175, camera.fov_deg || 120) * Math.PI) / 360);
    this.#lens.set(0, 0, -(camera.offset_m ?? 0.02)).applyQuaternion(attitude).add(position);
    this.#points.setXYZ(0, this.#lens.x, this.#lens.y, this.#lens.z);
    for (const [i, [front, left]] of CORNERS.entries()) {
      const ray = this.#direction.set(front * half * WIDE, left * half * HIGH, -1).normalize().applyQuaternion(attitude);
      const toFloor = ray.z < -1e-3 ? Math.max(0, this.#lens.z) / -ray.z : Infinity;
      const length = Math.min(LONGEST_M, toFloor);
      this.#points.setXYZ(i + 1, this.#lens.x + length * ray.x, this.#lens.y + length * ray.y, this.#lens.z + length * ray.z + 0.002);
    }
    this.#points.needsUpdate = true;
  }

  /** @param {THREE.ColorRepresentation} colour */
  setColour(colour) {
    for (const material of [this.#lines, this.#foot]) material.color.set(colour);
  }
}
