// The room of the tasks: floor and walls with a grid of 50 cm, its edges, and the marker's axes.

import * as THREE from "../../vendor/three/three.module.min.js";

/** Flights end outside of this. */
export const ROOM_M = { x: 5, y: 5, z: 2.8 };
const GRID_M = 0.5;

/** @param {string} text @param {string} colour */
function label(text, colour) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.font = "bold 46px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillStyle = colour;
  context.fillText(text, 32, 32);
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map, depthWrite: false }));
  sprite.scale.setScalar(0.09);
  return sprite;
}

/** An arrow on the floor. @param {string} name @param {string} colour @param {THREE.Vector3} direction */
function axis(name, colour, direction) {
  const group = new THREE.Group();
  const material = new THREE.MeshBasicMaterial({ color: colour });
  const shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.003, 0.003, 0.16, 10), material);
  shaft.position.y = 0.24;
  const head = new THREE.Mesh(new THREE.ConeGeometry(0.011, 0.035, 14), material);
  head.position.y = 0.335;
  const text = label(name, colour);
  text.position.set(0, 0.405, 0);
  group.add(shaft, head, text);
  group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), direction);
  group.position.z = 0.004;
  return group;
}

/** A wall tells of itself from so near. */
const NEAR_M = 1.2;

/** One square of the grid. @param {string} colour @param {string} line */
function tile(colour, line) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 128;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.fillStyle = colour;
  context.fillRect(0, 0, 128, 128);
  context.strokeStyle = line;
  context.lineWidth = 5;
  context.strokeRect(0, 0, 128, 128);
  const map = new THREE.CanvasTexture(canvas);
  Object.assign(map, { colorSpace: THREE.SRGBColorSpace, wrapS: THREE.RepeatWrapping, wrapT: THREE.RepeatWrapping, anisotropy: 8 });
  map.repeat.set(ROOM_M.x / GRID_M, ROOM_M.z / GRID_M);
  return map;
}

/** The four walls, seen from within: what is before them hides nothing. */
export class Walls extends THREE.Group {
  /** @param {{wall: string, grid: string, bad: string}} colours */
  constructor({ wall, grid, bad }) {
    super();
    this.warning = new THREE.Color(bad);
    const map = tile(wall, grid);
    for (const [x, y] of [[1, 0], [0, 1], [-1, 0], [0, -1]]) {
      const mesh = new THREE.Mesh(new THREE.PlaneGeometry(ROOM_M.x, ROOM_M.z), new THREE.MeshBasicMaterial({ map }));
      mesh.position.set((x * ROOM_M.x) / 2, (y * ROOM_M.y) / 2, ROOM_M.z / 2);
      mesh.rotation.set(Math.PI / 2, 0, Math.atan2(-x, y), "ZYX");
      mesh.userData.outwards = new THREE.Vector3(x, y, 0);
      this.add(mesh);
    }
  }

  /** Those that a drone comes near turn red. @param {THREE.Vector3} place */
  warn(place) {
    for (const wall of this.children) {
      const left_m = ROOM_M.x / 2 - place.dot(wall.userData.outwards);
      /** @type {any} */ (wall).material.color.set(0xffffff).lerp(this.warning, Math.min(0.8, Math.max(0, 1 - left_m / NEAR_M)));
    }
  }
}

/** @param {{floor: string, edge: string, x: string, y: string}} colours */
export function room(colours) {
  const group = new THREE.Group();
  const floor = new THREE.Mesh(new THREE.PlaneGeometry(ROOM_M.x, ROOM_M.y), new THREE.MeshStandardMaterial({ color: colours.floor, roughness: 1 }));
  floor.receiveShadow = true;
  const grid = new THREE.GridHelper(ROOM_M.x, ROOM_M.x / GRID_M, colours.edge, colours.edge).rotateX(Math.PI / 2);
  grid.position.z = 0.001;
  const box = new THREE.BoxGeometry(ROOM_M.x, ROOM_M.y, ROOM_M.z).translate(0, 0, ROOM_M.z / 2);
  const edges = new THREE.LineSegments(new THREE.EdgesGeometry(box), new THREE.LineBasicMaterial({ color: colours.edge, transparent: true, opacity: 0.5 }));
  group.add(floor, grid, edges, axis("x", colours.x, new THREE.Vector3(1, 0, 0)), axis("y", colours.y, new THREE.Vector3(0, 1, 0)));
  return group;
}
