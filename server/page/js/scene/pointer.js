// An arrow from one place to another, thick enough to be seen.

import * as THREE from "../../vendor/three/three.module.min.js";

const UP = new THREE.Vector3(0, 1, 0);
const HEAD_M = 0.07;

export class Pointer extends THREE.Group {
  #material = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.9 });
  #shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.006, 0.006, 1, 10).translate(0, 0.5, 0), this.#material);
  #head = new THREE.Mesh(new THREE.ConeGeometry(0.024, HEAD_M, 16), this.#material);
  #way = new THREE.Vector3();

  constructor() {
    super();
    this.add(this.#shaft, this.#head);
  }

  /** @param {THREE.ColorRepresentation} colour */
  setColour(colour) {
    this.#material.color.set(colour);
  }

  /** Hidden where both places are nearly the same. @param {THREE.Vector3} from @param {THREE.Vector3} to @param {number} gap Left free at the start. */
  update(from, to, gap) {
    this.#way.subVectors(to, from);
    const length = this.#way.length() - gap;
    this.visible = length > HEAD_M;
    if (!this.visible) return;
    this.#way.normalize();
    this.position.copy(from).addScaledVector(this.#way, gap);
    this.quaternion.setFromUnitVectors(UP, this.#way);
    this.#shaft.scale.y = length - HEAD_M;
    this.#head.position.y = length - HEAD_M / 2;
  }
}
