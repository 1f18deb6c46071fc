// Attempts as a table; on a narrow screen each row becomes a card.

import { make, moment, number } from "../dom.js";
import { address } from "../place.js";
import { METRICS, flown, metric } from "./attempt.js";
import { check, unchecked } from "./signature.js";

/** @typedef {import("./attempt.js").Attempt} Attempt */
/** @typedef {{has: (id: string) => boolean, set: (id: string, on: boolean) => void}} Marked */
/** @typedef {{head: string, class?: string, cell: (attempt: Attempt) => (Node | string)[]}} Column */

const SVG = "http://www.w3.org/2000/svg";
/** Scores go from 0 to this. */
const FULL = 100;

/** @param {string} tag @param {Record<string, string | number>} attributes */
function svg(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  return element;
}

/** @param {Attempt} attempt */
function who({ controller, team, attempts, former, id }) {
  const many = attempts > 1 ? ` · the middle one of ${attempts} attempts` : "";
  const names = former.map((entry) => `${entry.controller} (${entry.attempts} attempts, ${number(entry.score, 1)})`);
  const before = names.length ? [make("span", { class: "muted", title: "Only the name that a team used last is ranked" }, `before: ${names.join(", ")}`)] : [];
  return [make("strong", { title: `Attempt ${id}` }, controller || "–"), make("span", { class: "muted" }, team + many), ...before];
}

/** Score, and its interval as a bar. @param {Attempt} attempt */
function score({ score, low, high, status, problem }) {
  if (score === null) return [make("span", { class: "muted" }, problem ? `${status}: ${problem}` : status)];
  const interval = low === null || high === null ? "" : `${number(low, 1)} to ${number(high, 1)}`;
  const bar = svg("svg", { viewBox: `0 0 ${FULL} 10`, preserveAspectRatio: "none", class: "interval", "aria-hidden": "true" });
  bar.append(svg("rect", { class: "track", x: 0, y: 4, width: FULL, height: 2 }));
  if (low !== null && high !== null) bar.append(svg("rect", { class: "span", x: low, y: 2.5, width: Math.max(0.6, high - low), height: 5 }));
  bar.append(svg("rect", { class: "point", x: Math.min(FULL - 1, Math.max(0, score - 0.5)), y: 0, width: 1, height: 10 }));
  return [make("strong", {}, number(score, 1)), make("span", { class: "muted" }, interval), bar];
}

/** @param {Attempt} attempt */
function failures({ failed, episodes, score }) {
  if (score === null || failed === null) return ["–"];
  return [make("span", { class: failed ? "bad" : "good" }, `${failed} of ${episodes}`)];
}

/** A button that has the attempt checked. @param {Attempt} attempt */
function verify({ id, status, signature, problem }) {
  if (status === "damaged") return [make("span", { class: "bad", title: problem }, "✗ damaged")];
  if (status === "running") return ["–"];
  const result = make("span", { class: "verdict", role: "status" });
  const button = make("button", { type: "button", class: "small", title: `Signature ${signature}` }, "Verify");
  button.addEventListener("click", async () => {
    button.disabled = true;
    result.className = "verdict muted";
    result.textContent = "flying again…";
    const { good, text, detail } = await check(id).catch(unchecked);
    result.className = good ? "verdict good" : "verdict bad";
    result.textContent = text;
    result.title = detail;
    button.disabled = false;
  });
  return [button, result];
}

/** @param {Marked} marked @param {Attempt} attempt */
function actions(marked, attempt) {
  const { id, controller, team } = attempt;
  if (!flown(attempt)) return [];
  const mark = make("input", { type: "checkbox", class: "mark", value: id, checked: marked.has(id), "aria-label": `Compare ${controller} of ${team}` });
  mark.addEventListener("change", () => marked.set(id, mark.checked));
  return [make("a", { href: address("replay", { a: id }), "aria-label": `Replay ${controller} of ${team}` }, "Replay"), make("label", {}, mark, "compare")];
}

/** @param {Attempt} attempt @param {string} key */
function figure(attempt, key) {
  const { settled } = attempt.metrics;
  // the median of those that settled says little where few did
  const few = key === "settling_s" && settled > 0 && settled < attempt.episodes;
  return [metric(attempt, key), ...(few ? [make("span", { class: "muted" }, `${settled} of ${attempt.episodes}`)] : [])];
}

/** @param {Attempt[]} rows @param {Marked} marked @returns {Column[]} */
function columns(rows, marked) {
  const ranked = rows.some(({ rank }) => rank !== null);
  const told = Object.keys(METRICS).filter((key) => rows.some(({ metrics }) => typeof metrics[key] === "number"));
  return [
    ranked ? { head: "rank", class: "number rank", cell: ({ rank }) => [rank === null ? "–" : String(rank)] } : { head: "when", cell: ({ at }) => [moment(at)] },
    { head: "controller", class: "who", cell: who },
    { head: "score", class: "score", cell: score },
    { head: "failed", class: "number", cell: failures },
    ...told.map((key) => ({ head: METRICS[key][1] ? `${METRICS[key][0]} [${METRICS[key][1]}]` : METRICS[key][0], class: "number", cell: (/** @type {Attempt} */ row) => figure(row, key) })),
    { head: "verified", class: "verify", cell: verify },
    { head: "replay", class: "actions", cell: (row) => actions(marked, row) },
  ];
}

/** @param {Attempt[]} rows @param {string} caption @param {Marked} marked */
export function table(rows, caption, marked) {
  const shown = columns(rows, marked);
  // roles are said in full, because cards of a narrow screen would lose them
  const head = make("tr", { role: "row" }, ...shown.map(({ head: text, class: kind }) => make("th", { scope: "col", role: "columnheader", class: kind }, text)));
  const body = rows.map((row) =>
    make("tr", { role: "row" }, ...shown.map(({ head: text, class: kind, cell }) => make("td", { role: "cell", class: kind, "data-label": text }, ...cell(row)))),
  );
  return make("table", { class: "board", role: "table" }, make("caption", {}, caption), make("thead", { role: "rowgroup" }, head), make("tbody", { role: "rowgroup" }, ...body));
}
