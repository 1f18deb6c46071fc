// The 3D view: two flights to compare or all drones of a world in one room, drawn when something changed, not otherwise.

import * as THREE from "../../vendor/three/three.module.min.js";
import { OrbitControls } from "../../vendor/three/OrbitControls.js";
import { runColours } from "../colours.js";
import { colour, onTheme } from "../dom.js";
import { plainLook } from "./look.js";
import { plate } from "./plate.js";
import { ROOM_M, Walls, room } from "./room.js";
import { RunView } from "./run_view.js";

/** @typedef {import("../flight.js").Flight} Flight */

const LIGHT_Z_M = 6;
/** A view that moves with a vehicle begins at most so far away; a pilot's own looks below it, where its shadow is. */
const FOLLOWED_M = 1.1;
const PILOTED_M = 1.9;
const BELOW_M = 0.25;

export class Stage {
  splits = true;
  look = plainLook();
  runs = [new RunView(), new RunView()];
  #time_s = 0;
  #due = false;
  #scene = new THREE.Scene();
  #camera = new THREE.PerspectiveCamera(38, 1, 0.02, 60);
  #room = new THREE.Group();
  #plates = new THREE.Group();
  /** @type {Walls | null} */
  #walls = null;
  #followed = new THREE.Vector3(NaN);

  /** Throws if the browser has no WebGL. @param {HTMLElement} host */
  constructor(host) {
    this.host = host;
    this.renderer = new THREE.WebGLRenderer({ antialias: true });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.renderer.shadowMap.enabled = true;
    this.renderer.autoClear = false;
    this.canvas = this.renderer.domElement;
    host.prepend(this.canvas);
    this.#camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.#camera, this.canvas);
    Object.assign(this.controls, { maxPolarAngle: Math.PI / 2 - 0.02, minDistance: 0.15, maxDistance: 12, enableDamping: false, zoomSpeed: 0.8 });
    this.controls.addEventListener("change", () => this.request());
    this.#lights();
    this.#scene.add(this.#plates, ...this.runs);
    this.paint();
    onTheme(() => this.paint());
    this.home();
    new ResizeObserver(() => this.#resize()).observe(host);
    this.#resize();
  }

  #lights() {
    // straight from above, so that the shadow lies below the vehicle and shows where it is
    const sun = new THREE.DirectionalLight(0xffffff, 1.7);
    sun.position.set(0, 0, LIGHT_Z_M);
    sun.castShadow = true;
    sun.shadow.mapSize.set(2048, 2048);
    Object.assign(sun.shadow.camera, { left: -ROOM_M.x / 2, right: ROOM_M.x / 2, top: ROOM_M.y / 2, bottom: -ROOM_M.y / 2, near: 1, far: LIGHT_Z_M + 1 });
    sun.shadow.camera.up.set(0, 1, 0);
    sun.shadow.radius = 2.5;
    const side = new THREE.DirectionalLight(0xffffff, 0.8);
    side.position.set(3, -4, 3);
    this.#scene.add(sun, side, new THREE.HemisphereLight(0xffffff, 0x8090a0, 1.15));
  }

  /** Takes its colours from the style sheet. */
  paint() {
    this.#scene.background = new THREE.Color(colour("--sky"));
    this.#room.removeFromParent();
    this.#room = room({ floor: colour("--floor"), edge: colour("--edge"), x: colour("--axis-x"), y: colour("--axis-y") });
    this.#walls = new Walls({ wall: colour("--wall"), grid: colour("--grid"), bad: colour("--bad") });
    this.#room.add(this.#walls);
    this.#scene.add(this.#room);
    this.#paintRuns();
    this.request();
  }

  #paintRuns() {
    const drones = this.runs[0].flight?.header.drones ?? 1;
    const shown = drones === 1 ? this.runs.slice(0, 2) : this.runs;
    for (const [i, run] of shown.entries()) {
      const own = runColours(i, drones);
      const { single, pilot, ownRings } = this.look;
      run.faded = single !== null && single !== i;
      run.crowded = drones > 1 && single !== i;
      run.guided = pilot === i;
      run.setColours({ ...own, setpoint: ownRings ? own.run : colour("--setpoint"), lost: colour("--bad"), sky: colour("--sky"), body: colour("--body") });
    }
  }

  /** @param {(Flight | null)[]} flights */
  show(flights) {
    while (this.runs.length < flights.length) {
      const more = new RunView();
      this.runs.push(more);
      this.#scene.add(more);
    }
    for (const [i, run] of this.runs.entries()) run.flight = flights[i] ?? null;
    this.#paintRuns();
    const centres = flights.find((flight) => flight)?.header.marker ?? [[0, 0, 0]];
    if (JSON.stringify(centres) !== this.#plates.userData.centres) {
      this.#plates.userData.centres = JSON.stringify(centres);
      this.#plates.clear();
      for (const centre of centres) this.#plates.add(plate(centre));
    }
    this.request();
  }

  /** @param {number} time_s */
  setTime(time_s) {
    this.#time_s = time_s;
    this.request();
  }

  /** @param {Partial<import("./look.js").Look>} look */
  setLook(look) {
    Object.assign(this.look, look);
    this.#followed.setScalar(NaN);
    this.#paintRuns();
    this.request();
  }

  /** From the front right, at most so far away as shows `reach_m` around the marker. @param {number} [reach_m] */
  home(reach_m = ROOM_M.x / 2) {
    this.#aim(new THREE.Vector3(0.62, -0.68, 0.42), reach_m);
  }

  /** From behind and above, as a pilot stands: what flies ahead flies away. Near by, if the view moves with the drone. @param {number} [aside] How much from the right. */
  behind(aside = 0) {
    this.#aim(new THREE.Vector3(-1, -aside, 0.5), ROOM_M.x / 2, 0.15);
    this.#followed.setScalar(NaN);
  }

  top() {
    this.#aim(new THREE.Vector3(0, -0.001, 1));
  }

  side() {
    this.#aim(new THREE.Vector3(0, -1, 0.06));
  }

  /** From a direction, as far away as shows all, and the marker's surroundings in any case. @param {THREE.Vector3} direction @param {number} [reach_m] @param {number} [lower_m] So far below its middle it looks. */
  #aim(direction, reach_m = ROOM_M.x / 2, lower_m = 0) {
    const box = new THREE.Box3(new THREE.Vector3(-0.5, -0.5, 0), new THREE.Vector3(0.5, 0.5, 0.8));
    for (const { flight } of this.runs) {
      for (let row = 0; flight && row < flight.rows; row += 5) {
        const point = new THREE.Vector3(...["x", "y", "z"].map((name) => flight.get(name, row)));
        box.expandByPoint(point.clampScalar(-reach_m, reach_m));
      }
    }
    const sphere = box.getBoundingSphere(new THREE.Sphere());
    sphere.center.z -= lower_m;
    sphere.radius += lower_m;
    const narrow = Math.min(1, this.#camera.aspect);
    const distance = (0.88 * sphere.radius) / Math.sin((this.#camera.fov * Math.PI) / 360) / narrow;
    this.controls.target.copy(sphere.center);
    this.#camera.position.copy(sphere.center).addScaledVector(direction.normalize(), distance);
    this.controls.update();
    this.request();
  }

  /** Draws in the browser's next frame, which does not come while the page is hidden. */
  request() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => {
      this.#due = false;
      this.#draw();
    });
  }

  #resize() {
    const { clientWidth, clientHeight } = this.host;
    if (!clientWidth || !clientHeight) return;
    this.renderer.setSize(clientWidth, clientHeight);
    this.#camera.aspect = clientWidth / clientHeight;
    this.request();
  }

  #follow() {
    const run = this.runs[this.look.single ?? this.look.pilot ?? this.runs.findIndex((candidate) => candidate.visible)];
    if (!this.look.follow || !run?.visible) return;
    const now = run.vehicle.position;
    if (Number.isFinite(this.#followed.x)) {
      const moved = now.clone().sub(this.#followed);
      this.#camera.position.add(moved);
      this.controls.target.add(moved);
    } else {
      const offset = this.#camera.position.clone().sub(this.controls.target);
      const piloted = run.guided;
      this.controls.target.copy(now).setZ(piloted ? Math.max(0, now.z - BELOW_M) : now.z);
      this.#camera.position.copy(this.controls.target).add(offset.setLength(Math.min(offset.length(), piloted ? PILOTED_M : FOLLOWED_M)));
    }
    this.#followed.copy(now);
    this.#camera.lookAt(this.controls.target);
  }

  #draw() {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    for (const run of this.runs) run.update(this.#time_s, this.look);
    const pilot = this.look.pilot === null ? null : this.runs[this.look.pilot];
    if (this.#walls) this.#walls.visible = pilot !== null;
    if (pilot) this.#walls?.warn(pilot.vehicle.position);
    this.#follow();
    const shown = this.runs.filter((run) => run.visible);
    const halves = this.look.split && shown.length === 2 ? shown.map((run) => [run]) : [shown];
    this.renderer.setScissorTest(halves.length > 1);
    this.renderer.setViewport(0, 0, width, height);
    this.renderer.setScissor(0, 0, width, height);
    for (const [i, half] of halves.entries()) {
      const share = width / halves.length;
      this.renderer.setViewport(i * share, 0, share, height);
      this.renderer.setScissor(i * share, 0, share, height);
      this.#camera.aspect = share / height;
      this.#camera.updateProjectionMatrix();
      for (const run of shown) run.visible = half.includes(run);
      this.renderer.clear();
      this.renderer.render(this.#scene, this.#camera);
    }
    for (const run of shown) run.visible = true;
  }
}
