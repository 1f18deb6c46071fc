// The marker on the floor: a real one of ArUco's original dictionary, 7 x 7 cells with its black border.

import * as THREE from "../../vendor/three/three.module.min.js";

/** Side of the black square, as measured by the thesis. */
const SIDE_M = 0.197;
/** Two bits each, as the dictionary's Hamming code writes them. */
const WORDS = [0b10000, 0b10111, 0b01001, 0b01110];
/** Number of the first plate; others count on from here. */
const FIRST_ID = 26;

/** @param {number} id 0 to 1023 */
function picture(id) {
  const cell = 32;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 9 * cell;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.fillStyle = "#fff";
  context.fillRect(0, 0, 9 * cell, 9 * cell);
  context.fillStyle = "#0a0a0a";
  context.fillRect(cell, cell, 7 * cell, 7 * cell);
  context.fillStyle = "#fff";
  for (let row = 0; row < 5; row += 1) {
    const word = WORDS[(id >> (2 * (4 - row))) & 3];
    for (let column = 0; column < 5; column += 1) {
      if ((word >> (4 - column)) & 1) context.fillRect((2 + column) * cell, (2 + row) * cell, cell, cell);
    }
  }
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.anisotropy = 8;
  return texture;
}

/** @param {number[]} centre @param {number} index */
export function plate(centre, index) {
  const side = (SIDE_M * 9) / 7;
  const material = new THREE.MeshStandardMaterial({ map: picture((FIRST_ID + index) % 1024), roughness: 0.9 });
  const mesh = new THREE.Mesh(new THREE.BoxGeometry(side, side, 0.003), material);
  mesh.position.set(centre[0], centre[1], (centre[2] ?? 0) + 0.0015);
  mesh.receiveShadow = true;
  return mesh;
}
