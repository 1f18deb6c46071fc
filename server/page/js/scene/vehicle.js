// The quadrotor, at its own size: 92 mm from motor to motor. Body axes: x to the front, y to the left, z up; the origin is the centre of mass.

import * as THREE from "../../vendor/three/three.module.min.js";

/** Motors from the centre, along x and along y. */
const ARM_M = 0.0325;
const ROTOR_M = 0.0235;
const ROTOR_Z_M = 0.012;
/** Feet below the centre: the lens is 20 mm below it. */
export const FEET_M = 0.024;

/** @param {number} colour @param {number} [roughness] */
const matt = (colour, roughness = 0.7) => new THREE.MeshStandardMaterial({ color: colour, roughness });

/** @param {THREE.Object3D} parent @param {THREE.BufferGeometry} geometry @param {THREE.Material} material @param {[number, number, number]} at */
function part(parent, geometry, material, at) {
  const mesh = new THREE.Mesh(geometry, material);
  mesh.position.set(...at);
  mesh.castShadow = true;
  parent.add(mesh);
  return mesh;
}

/** A cylinder along z. @param {number} radius @param {number} height */
const rod = (radius, height) => new THREE.CylinderGeometry(radius, radius, height, 20).rotateX(Math.PI / 2);

export class Vehicle extends THREE.Group {
  #rotors = /** @type {THREE.Object3D[]} */ ([]);
  #body = matt(0);
  #accents = [matt(0xffffff, 0.5), new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.5, side: THREE.DoubleSide, depthWrite: false })];

  constructor() {
    super();
    const dark = this.#body;
    part(this, new THREE.BoxGeometry(0.031, 0.029, 0.0025), dark, [0, 0, 0]);
    part(this, new THREE.BoxGeometry(0.03, 0.018, 0.0075), this.#accents[0], [-0.001, 0, 0.0055]);
    part(this, new THREE.BoxGeometry(0.016, 0.016, 0.012), dark, [0, 0, -0.0075]);
    part(this, rod(0.0042, 0.006), matt(0x0b0d10, 0.25), [0, 0, -0.0165]);
    // the front: a nose that points along x
    const nose = new THREE.ConeGeometry(0.0075, 0.021, 20).rotateZ(-Math.PI / 2);
    part(this, nose, new THREE.MeshStandardMaterial({ color: 0xffc21a, emissive: 0x7a5200, roughness: 0.5 }), [0.0285, 0, 0.001]);
    for (const [front, left] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) this.#arm(front, left, dark);
  }

  /** @param {number} front @param {number} left @param {THREE.Material} dark */
  #arm(front, left, dark) {
    const length = Math.hypot(ARM_M, ARM_M);
    const beam = part(this, new THREE.BoxGeometry(length, 0.0052, 0.0032), front > 0 ? this.#accents[0] : dark, [(front * ARM_M) / 2, (left * ARM_M) / 2, 0]);
    beam.rotation.z = Math.atan2(left, front);
    part(this, rod(0.0042, 0.018), dark, [front * ARM_M, left * ARM_M, 0.001]);
    part(this, rod(0.0016, FEET_M - 0.008), dark, [front * ARM_M, left * ARM_M, -0.008 - (FEET_M - 0.008) / 2]);
    const rotor = new THREE.Group();
    rotor.position.set(front * ARM_M, left * ARM_M, ROTOR_Z_M);
    // neighbours turn against each other
    rotor.userData.sense = front * left;
    const swept = front > 0 ? this.#accents[1] : new THREE.MeshBasicMaterial({ color: 0x8a94a3, transparent: true, opacity: 0.38, side: THREE.DoubleSide, depthWrite: false });
    part(rotor, new THREE.CircleGeometry(ROTOR_M, 36), swept, [0, 0, 0]).castShadow = false;
    part(rotor, new THREE.TorusGeometry(ROTOR_M, 0.0007, 6, 40), front > 0 ? this.#accents[0] : dark, [0, 0, 0]);
    part(rotor, new THREE.BoxGeometry(2 * ROTOR_M - 0.002, 0.0045, 0.0008), dark, [0, 0, 0]);
    part(rotor, rod(0.0026, 0.004), dark, [0, 0, 0]);
    this.#rotors.push(rotor);
    this.add(rotor);
  }

  /** @param {THREE.ColorRepresentation} colour Battery, front arms and front rotors. @param {THREE.ColorRepresentation} body All else. */
  setColour(colour, body) {
    this.#body.color.set(body);
    for (const material of this.#accents) /** @type {any} */ (material).color.set(colour);
  }

  /** Blades by the time that is shown, slow enough to be seen turning. @param {number} time_s */
  turnRotors(time_s) {
    for (const [i, rotor] of this.#rotors.entries()) rotor.rotation.z = rotor.userData.sense * time_s * 23 + i;
  }
}
