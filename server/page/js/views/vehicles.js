// The server's registry of vehicles, for lists to choose from.

import { getJson } from "../api.js";
import { make } from "../dom.js";

/** Fills a list once, the default first. @param {HTMLSelectElement} list @returns {Promise<Record<string, string[]>>} Vertical forms by vehicle. */
export async function fillVehicles(list) {
  const vehicles = await getJson("vehicles");
  if (!list.options.length) list.append(...vehicles.map((/** @type {any} */ { name }) => make("option", { value: name }, name)));
  return Object.fromEntries(vehicles.map((/** @type {any} */ { name, verticals }) => [name, verticals]));
}
