// Set-point of the vehicle: a ring with a tick that shows the heading, and a plumb line.

import * as THREE from "../../vendor/three/three.module.min.js";

const RADIUS_M = 0.055;

export class Setpoint extends THREE.Group {
  #solid = new THREE.MeshBasicMaterial();
  #line = new THREE.LineDashedMaterial({ dashSize: 0.02, gapSize: 0.015, transparent: true, opacity: 0.7 });
  #mark = new THREE.Group();
  #plumb;
  /** Foot of the plumb line on the floor. */
  #foot = new THREE.Mesh(new THREE.RingGeometry(RADIUS_M - 0.006, RADIUS_M, 40), this.#solid);

  constructor() {
    super();
    this.#mark.add(new THREE.Mesh(new THREE.TorusGeometry(RADIUS_M, 0.003, 8, 48), this.#solid), new THREE.Mesh(new THREE.SphereGeometry(0.007, 16, 12), this.#solid));
    const heading = new THREE.Mesh(new THREE.ConeGeometry(0.011, 0.03, 12).rotateZ(-Math.PI / 2), this.#solid);
    heading.position.x = RADIUS_M + 0.012;
    this.#mark.add(heading);
    this.#plumb = new THREE.Line(new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), new THREE.Vector3(0, 0, 1)]), this.#line);
    this.#plumb.computeLineDistances();
    this.add(this.#mark, this.#plumb, this.#foot);
  }

  /** @param {THREE.ColorRepresentation} colour */
  setColour(colour) {
    this.#solid.color.set(colour);
    this.#line.color.set(colour);
  }

  /** @param {import("../flight.js").Row} state */
  update(state) {
    const { setpoint_x: x, setpoint_y: y, setpoint_z: z, setpoint_yaw: yaw } = state;
    this.visible = [x, y, z].every(Number.isFinite);
    if (!this.visible) return;
    this.#mark.position.set(x, y, z);
    this.#mark.rotation.z = yaw || 0;
    this.#plumb.position.set(x, y, 0);
    this.#foot.position.set(x, y, 0.004);
    this.#plumb.scale.z = Math.max(1e-6, z);
    this.#line.scale = Math.max(1e-6, z);
  }
}
