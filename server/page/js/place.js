// View and its options in the address: `#replay?a=ID&b=ID&episode=3&t=4.215`. A view can be linked, and the back button works.

/** @typedef {"live" | "fly" | "board" | "replay" | "log" | "tuner"} View */
/** @typedef {{view: View, query: URLSearchParams}} Place */

const VIEWS = ["live", "fly", "board", "replay", "log", "tuner"];

/** @returns {Place} */
export function here() {
  const [name, query = ""] = location.hash.slice(1).split("?");
  const view = /** @type {View} */ (VIEWS.includes(name) ? name : "live");
  return { view, query: new URLSearchParams(query) };
}

/** @param {View} view @param {Record<string, string | number | null | undefined>} query Empty values are left out. */
export function address(view, query = {}) {
  const kept = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
  const text = new URLSearchParams(kept.map(([key, value]) => [key, String(value)])).toString();
  return text ? `#${view}?${text}` : `#${view}`;
}

/** Goes somewhere else: a step in the history. @param {View} view @param {Record<string, any>} query */
export function go(view, query = {}) {
  location.hash = address(view, query);
}

/** Notes details of where we are: no step in the history, and nobody is told. @param {Record<string, any>} changes null takes a detail away. */
export function note(changes) {
  const { view, query } = here();
  history.replaceState(null, "", address(view, { ...Object.fromEntries(query), ...changes }));
}
