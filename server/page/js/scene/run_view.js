// One flight in the room: vehicle, plumb line, shadow, view cone, trails, fixes, set-point.

import * as THREE from "../../vendor/three/three.module.min.js";
import { Fixes } from "./fixes.js";
import { Pointer } from "./pointer.js";
import { Setpoint } from "./setpoint.js";
import { Trail } from "./trail.js";
import { FEET_M, Vehicle } from "./vehicle.js";
import { ViewCone } from "./view_cone.js";

/** @typedef {import("../flight.js").Flight} Flight */
/** @typedef {{run: string, fix: string, setpoint: string, lost: string, sky: string, body: string}} Colours */

const SHADOW_M = 0.05;
/** Feet of lines lie so high above the floor. */
const FLOOR_M = 0.005;
/** Share of the sky's colour in all drones except a selected one. */
const FADED = 0.75;

export class RunView extends THREE.Group {
  /** @type {Flight | null} */
  flight = null;
  /** One of many: without what would hide the others. */
  crowded = false;
  /** Another one is singled out. */
  faded = false;
  /** Arrows lead to its set-point: at the drone, and on the floor. */
  guided = false;
  vehicle = new Vehicle();
  cone = new ViewCone();
  #plumb = new THREE.Line(new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), new THREE.Vector3(0, 0, 1)]), new THREE.LineBasicMaterial({ transparent: true, opacity: 0.55 }));
  #trail = new Trail(["x", "y", "z"], { width: 3.5, faded: 0.7 });
  #asked = new Trail(["setpoint_x", "setpoint_y", "setpoint_z"], { width: 1.75, faded: 0.7 });
  #fixes = new Fixes();
  #setpoint = new Setpoint();
  #shadow = new THREE.Mesh(new THREE.CircleGeometry(SHADOW_M, 32), new THREE.MeshBasicMaterial({ color: 0, transparent: true, opacity: 0.28, depthWrite: false }));
  #pointers = [new Pointer(), new Pointer()];
  /** @type {Colours} */
  #colours = { run: "#888", fix: "#888", setpoint: "#888", lost: "#888", sky: "#888", body: "#888" };

  constructor() {
    super();
    this.add(this.vehicle, this.cone, this.#plumb, this.#trail, this.#asked, this.#fixes, this.#setpoint, this.#shadow, ...this.#pointers);
    this.visible = false;
  }

  /** @param {Colours} colours */
  setColours(colours) {
    this.#colours = colours;
    const seen = (/** @type {string} */ own) => new THREE.Color(own).lerp(new THREE.Color(colours.sky), this.faded ? FADED : 0);
    this.vehicle.setColour(seen(colours.run), seen(colours.body));
    this.#trail.setColour(colours.run, colours.sky);
    this.#fixes.setColour(colours.fix);
    this.#setpoint.setColour(colours.setpoint);
    this.#asked.setColour(colours.setpoint, colours.sky);
    this.#plumb.material.color.set(colours.run);
    for (const pointer of this.#pointers) pointer.setColour(colours.setpoint);
  }

  /** @param {number} time_s @param {{vehicleScale: number, cone: boolean, spin: boolean}} look */
  update(time_s, { vehicleScale, cone, spin }) {
    const state = this.flight?.at(time_s);
    this.visible = Boolean(state);
    if (!this.flight || !state) return;
    const { vehicle } = this;
    vehicle.scale.setScalar(vehicleScale);
    // feet stay on the floor, also those of a vehicle drawn larger than it is
    vehicle.position.set(state.x, state.y, Math.max(state.z, FEET_M * vehicleScale));
    vehicle.rotation.set(state.roll, state.pitch, state.yaw, "ZYX");
    if (spin && !(state.flying < 0.5)) vehicle.turnRotors(time_s);
    this.#plumb.position.set(state.x, state.y, 0);
    this.#plumb.scale.z = Math.max(1e-6, state.z);
    this.#shadow.position.set(state.x, state.y, FLOOR_M);
    this.#shadow.scale.setScalar(vehicleScale);
    this.cone.visible = cone && !this.crowded && this.flight.has("fix_valid");
    this.cone.setColour(state.fix_valid > 0.5 ? this.#colours.run : this.#colours.lost);
    if (this.cone.visible) this.cone.update(new THREE.Vector3(state.x, state.y, state.z), vehicle.quaternion, this.flight.header.camera ?? { fov_deg: 120, offset_m: 0.02 });
    const row = this.flight.rowAt(time_s);
    this.#trail.update(this.flight, row);
    this.#setpoint.update(state);
    this.#guide(state);
    this.#setpoint.visible &&= !this.faded;
    this.#trail.visible = this.#plumb.visible = !this.faded;
    this.#asked.visible = !this.crowded && this.flight.has("setpoint_x");
    this.#fixes.visible = !this.crowded;
    if (this.crowded) return;
    if (this.#asked.visible) this.#asked.update(this.flight, row);
    this.#fixes.update(this.flight, time_s);
  }
  /** @param {import("../flight.js").Row} state */
  #guide({ setpoint_x: x, setpoint_y: y, setpoint_z: z }) {
    const [above, below] = this.#pointers;
    const { position } = this.vehicle;
    above.update(position, new THREE.Vector3(x, y, z), 2 * SHADOW_M);
    below.update(new THREE.Vector3(position.x, position.y, FLOOR_M), new THREE.Vector3(x, y, FLOOR_M), SHADOW_M);
    for (const pointer of this.#pointers) pointer.visible &&= this.guided;
  }
}
