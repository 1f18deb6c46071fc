// Puts the page together: one 3D view and one set of charts, shared by the live view, flights by hand, the replay and logs; the leaderboard; and the tuner.

import { extensions } from "./api.js";
import { byId } from "./dom.js";
import { Display } from "./views/display.js";
import { Board } from "./views/board.js";
import { FlyView } from "./views/fly_view.js";
import { LiveView } from "./views/live_view.js";
import { LogView } from "./views/log_view.js";
import { ReplayView } from "./views/replay_view.js";
import { Tuner } from "./views/tuner.js";
import { failure } from "./views/notice.js";
import { go, here } from "./place.js";

const TITLES = { live: "Live", fly: "Fly", board: "Leaderboard", replay: "Replay", log: "Log", tuner: "Tuner" };

const offered = await extensions;
for (const part of document.querySelectorAll("[data-extension]")) {
  if (part instanceof HTMLElement) part.hidden = !offered.includes(part.dataset.extension ?? "");
}
const display = new Display();
/** @type {Partial<Record<import("./place.js").View, {enter: (query: URLSearchParams) => Promise<void> | void, leave: () => void}>>} */
const views = { live: new LiveView(display), fly: new FlyView(display), log: new LogView(display), tuner: new Tuner() };
if (offered.includes("benchmark")) Object.assign(views, { board: new Board(), replay: new ReplayView(display) });
/** @type {import("./place.js").View | null} */
let shown = null;

async function route() {
  const { view, query } = here();
  const next = views[view];
  if (!next) return go("live");
  if (shown && shown !== view) views[shown]?.leave();
  shown = view;
  document.title = `${TITLES[view]} – Crazyflie`;
  document.body.dataset.view = view;
  byId("flight").hidden = view === "board" || view === "tuner";
  for (const id of ["welcome", "front"]) byId(id).hidden = view !== "live";
  byId("board").hidden = view !== "board";
  byId("tuner").hidden = view !== "tuner";
  for (const link of document.querySelectorAll("nav a")) {
    if (link instanceof HTMLElement && link.dataset.view === view) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  try {
    await next.enter(query);
  } catch (error) {
    failure(view, error);
  }
}

/** @type {HTMLDialogElement} */
const help = byId("help");
byId("help-open").addEventListener("click", () => help.showModal());
document.addEventListener("keydown", (event) => {
  if (event.key === "?" && !help.open) help.showModal();
});
document.querySelector(".skip")?.addEventListener("click", (event) => {
  // the address says what is shown: the link may not change it
  event.preventDefault();
  byId("main").focus();
});
window.addEventListener("hashchange", route);
route();
