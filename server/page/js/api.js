// Requests of the page to the server over HTTP.

import { parseFrame, perDrone } from "./flight.js";

const BASE = "api/v1/";

/** An answer that is none: its message is for people. */
export class ApiError extends Error {
  /** @param {string} message @param {number} status 0 if the server did not answer at all. */
  constructor(message, status) {
    super(message);
    this.status = status;
    /** Faults of a log. @type {any[]} */
    this.findings = [];
  }
}

/** @param {string} path Below api/v1/. @param {RequestInit} [options] */
async function request(path, options = {}) {
  let response;
  try {
    response = await fetch(BASE + path, { cache: "no-store", ...options });
  } catch {
    throw new ApiError("The server does not answer.", 0);
  }
  if (response.ok) return response;
  throw await refusal(response);
}

/** Error that the server reports. @param {Response} response */
async function refusal(response) {
  const error = (/** @type {string} */ said) => new ApiError(`Error of the server: ${said} (${response.status})`, response.status);
  const text = await response.text().catch(() => "");
  try {
    const body = JSON.parse(text);
    const said = body.message ?? body.error?.message ?? body.error;
    if (typeof said === "string") return Object.assign(error(said), { findings: body.findings ?? [] });
  } catch {
    // not JSON: shown as it is
  }
  return error(text.trim().slice(0, 200) || response.statusText || "an error without words");
}

/** @param {string} path @param {Record<string, string | number>} [query] */
export async function getJson(path, query = {}) {
  return jsonOf(path, await request(path + asked(query)));
}

/** @param {Record<string, string | number>} query */
function asked(query) {
  const text = new URLSearchParams(Object.entries(query).map(([key, value]) => [key, String(value)])).toString();
  return text && `?${text}`;
}

/** @param {string} path @param {Response} response */
async function jsonOf(path, response) {
  try {
    return await response.json();
  } catch {
    throw new ApiError(`The answer to ${path} is not JSON.`, response.status);
  }
}

/** Names of the server's extensions, besides environments and worlds. @type {Promise<string[]>} */
export const extensions = getJson("extensions").catch(() => []);

/** The flights of one episode of an attempt, one for each drone. @param {string} attempt @param {number} episode */
export async function getReplay(attempt, episode) {
  const response = await request(`attempts/${encodeURIComponent(attempt)}/replay?episode=${episode}`);
  const { header, values } = parseFrame(await response.arrayBuffer());
  return perDrone(header, values);
}

/** A flight log beside its model. @param {File} file @param {Record<string, string>} query @param {AbortSignal} signal */
export async function replayLog(file, query, signal) {
  const path = "log-replay";
  return jsonOf(path, await request(path + asked(query), { method: "POST", body: file, signal }));
}

/** Requests data that is the same for all visitors and seldom changes: the browser caches it and revalidates. @param {string} path */
export function getCached(path) {
  return request(path, { cache: "no-cache" });
}

/** A flight that is kept so, one for each drone. @param {string} path */
export async function getFlight(path) {
  const { header, values } = parseFrame(await (await getCached(path)).arrayBuffer());
  return perDrone(header, values);
}

/** Address of a download of an attempt. @param {string} attempt @param {string} file */
export function downloadUrl(attempt, file) {
  return `${BASE}attempts/${encodeURIComponent(attempt)}/${file}`;
}
