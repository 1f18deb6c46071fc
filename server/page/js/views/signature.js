// Checks of an attempt: the browser verifies its signature by the server's key, and the server flies it again and compares the bits.

import { ApiError, getJson } from "../api.js";

/** @typedef {{good: boolean, text: string, detail: string}} Finding */

/** Meaning of each verdict of the server. @type {Record<string, [boolean, string]>} */
const VERDICTS = {
  confirmed: [true, "✓ same bits again"],
  other_build: [true, "✓ signed; other build"],
  unfinished: [true, "✓ signed"],
  wrong: [false, "✗ not what was signed"],
};

/** JSON in the one form that is signed (RFC 8785): keys in order, no spaces. @param {any} value @returns {string} */
export function canonical(value) {
  if (Array.isArray(value)) return `[${value.map(canonical).join(",")}]`;
  if (value === null || typeof value !== "object") return JSON.stringify(value);
  const members = Object.keys(value).sort().map((key) => `${JSON.stringify(key)}:${canonical(value[key])}`);
  return `{${members.join(",")}}`;
}

/** @param {string} hex */
function bytes(hex) {
  return Uint8Array.from(hex.match(/../g) ?? [], (pair) => Number.parseInt(pair, 16));
}

/** True if the signature is valid; undefined if this browser cannot verify it. @param {any} told An attempt, whole. @param {string} publicKey Hex. */
async function signed({ signature, at: _at, ...document }, publicKey) {
  try {
    const key = await crypto.subtle.importKey("raw", bytes(publicKey), "Ed25519", false, ["verify"]);
    return await crypto.subtle.verify("Ed25519", key, bytes(signature), new TextEncoder().encode(canonical(document)));
  } catch {
    return undefined;
  }
}

/** @param {string} id @returns {Promise<Finding>} */
export async function check(id) {
  const path = `attempts/${encodeURIComponent(id)}`;
  const [told, key, verified] = await Promise.all([getJson(path), getJson("key"), getJson(`${path}/verify`)]);
  if (told.status === "damaged") return { good: false, text: "✗ damaged", detail: told.problem };
  const fits = await signed(told, key.public_key);
  if (fits === false) return { good: false, text: "✗ signature", detail: "The signature does not fit the attempt." };
  const [good, text] = VERDICTS[verified.verdict] ?? [false, String(verified.verdict)];
  const own = fits ? "This browser checked the signature." : "This browser cannot check Ed25519 signatures; the server did.";
  return { good, text, detail: [own, ...(verified.findings ?? [])].join(" ") };
}

/** @param {unknown} error @returns {Finding} */
export function unchecked(error) {
  const gone = error instanceof ApiError && error.status === 0;
  return { good: false, text: gone ? "no answer" : "✗ not checked", detail: error instanceof Error ? error.message : String(error) };
}
