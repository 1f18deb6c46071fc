// Running sessions, and the one that is watched.

import { getJson } from "../api.js";
import { byId, make } from "../dom.js";
import { Live } from "../live.js";
import { address, go, here, note } from "../place.js";
import { front } from "./front.js";
import { failure, notice } from "./notice.js";
import { Showcase } from "./showcase.js";

const POLL_MS = 2000;
/** The server shows so many environments of a batch, the first ones. */
const WATCHABLE = 16;
/** So long is the end of a session told of before another one is watched; so long may the one that is watched stand still. */
const TOLD_MS = 6000;
const NOBODY = "No session is running. One appears here as soon as a program steps an environment of this server, or somebody flies by hand.";

export class LiveView {
  #live = new Live();
  #showcase;
  /** Since when the session that is watched has not flown. */
  #still_ms = Infinity;
  /** Steps of each session when the server was asked before. @type {Map<string, number>} */
  #steps = new Map();
  /** @type {string | null} */
  #watched = null;
  #env = 0;
  /** Chosen by a person or the address: not exchanged for another before it ends. */
  #chosen = false;
  #timer = 0;
  #active = false;
  #shown = false;

  /** @param {import("./display.js").Display} display */
  constructor(display) {
    this.display = display;
    front();
    this.#showcase = new Showcase(display);
    this.#live.addEventListener("flight", () => this.#grow());
    this.#live.addEventListener("state", () => notice("live", this.#live.connected ? null : "The connection to the server is lost. Trying again…"));
    this.#live.addEventListener("trouble", (event) => failure("live-data", /** @type {CustomEvent} */ (event).detail));
    document.addEventListener("visibilitychange", () => {
      if (!this.#active || document.hidden) return;
      this.#poll();
      this.#grow();
    });
  }

  /** @param {URLSearchParams} query */
  async enter(query) {
    const asked = query.get("session");
    this.#chosen = asked !== null;
    if (!this.#active) {
      this.display.show([], { live: true });
      this.display.setTime(0);
    }
    this.#active = true;
    if (asked !== null) this.#watch(asked, Number(query.get("env")) || 0);
    await this.#poll();
  }

  leave() {
    this.#active = false;
    clearTimeout(this.#timer);
    this.#showcase.hide();
    this.#live.watch(null);
    this.#watched = null;
    this.#shown = false;
    this.display.say("");
    for (const subject of ["live", "live-data", "sessions"]) notice(subject, null);
  }

  /** Asks who is there, again and again while the page can be seen. */
  async #poll() {
    clearTimeout(this.#timer);
    if (document.hidden) return;
    try {
      const sessions = await getJson("sessions");
      if (!this.#active) return;
      notice("sessions", null);
      this.#list(sessions);
    } catch (error) {
      if (this.#active) failure("sessions", error);
    }
    if (this.#active) this.#timer = window.setTimeout(() => this.#poll(), POLL_MS);
  }

  /** @param {any[]} sessions */
  #list(sessions) {
    const ids = sessions.map(({ session }) => String(session));
    const flying = sessions.filter(({ session, steps }) => steps > (this.#steps.get(String(session)) ?? 0));
    this.#steps = new Map(sessions.map(({ session, steps }) => [String(session), steps]));
    const gone = this.#watched !== null && !ids.includes(this.#watched);
    const still = this.#watched === null || !flying.some(({ session }) => String(session) === this.#watched);
    this.#still_ms = still ? Math.min(this.#still_ms, performance.now()) : Infinity;
    const long = performance.now() - this.#still_ms > TOLD_MS;
    const next = best(flying) ?? (this.#watched === null || gone ? best(sessions) : null);
    if (gone && long && this.#chosen) this.#release();
    if (next && !this.#chosen && (this.#watched === null || gone || long)) this.#watch(next);
    else if (gone && long && !this.#chosen) this.#forget();
    if (this.#watched === null) this.#showcase.show();
    else if (!ids.includes(this.#watched)) this.display.say(`Session ${this.#watched} has ended.`);
    else this.display.say(this.#live.flights.length ? "" : "Waiting for the first step of this session…");
    // a list that is in use is not taken away
    if (byId("sessions").contains(document.activeElement) && document.activeElement?.matches("select")) return;
    const focused = document.activeElement?.getAttribute("href");
    byId("sessions").replaceChildren(...(sessions.length ? sessions.map((session) => this.#entry(session)) : [make("li", { class: "muted" }, NOBODY)]));
    if (focused) [...byId("sessions").querySelectorAll("a")].find((link) => link.getAttribute("href") === focused)?.focus();
  }

  /** @param {any} session */
  #entry({ session, env, num_envs, drones, world, steps, since_s }) {
    const watched = String(session) === this.#watched;
    const shared = world === undefined ? null : `world ${world}, ${drones} drones`;
    const facts = `${shared ?? (num_envs === 1 ? "1 environment" : `${num_envs} environments`)} · ${Number(steps).toLocaleString()} steps · ${duration(since_s)}`;
    const link = make("a", { href: address("live", { session }), "aria-current": watched ? "true" : undefined }, make("strong", {}, env), make("span", { class: "muted" }, facts));
    return make("li", {}, link, watched && num_envs > 1 ? this.#envs(session, num_envs) : null);
  }

  /** Which environment of a batch is watched. @param {string} session @param {number} count */
  #envs(session, count) {
    const choices = Array.from({ length: Math.min(count, WATCHABLE) }, (_, i) => make("option", { value: String(i), selected: i === this.#env }, `Environment ${i + 1}`));
    const select = make("select", { "aria-label": "Environment that is watched" }, ...choices);
    select.addEventListener("change", () => go("live", { session, env: select.value }));
    return select;
  }

  /** @param {string} session @param {number} [env] Which of its environments. */
  #watch(session, env = 0) {
    if (session === this.#watched && env === this.#env) return;
    this.#watched = session;
    this.#still_ms = Infinity;
    this.#env = env;
    this.#shown = false;
    // the session before may have ended while it was asked for
    notice("live-data", null);
    this.#showcase.hide();
    this.display.show([], { live: true });
    this.#live.watch(session, env);
  }

  /** Leaves the session of the address, which is over. */
  #release() {
    this.#chosen = false;
    note({ session: null, env: null });
  }

  /** Nothing is watched any more. */
  #forget() {
    this.#watched = null;
    this.#live.watch(null);
    for (const subject of ["live", "live-data"]) notice(subject, null);
  }

  #grow() {
    const { flights } = this.#live;
    if (!flights.length || here().view !== "live") return;
    if (!this.#shown) {
      this.display.say("");
      this.display.show(flights, { live: true });
      this.#shown = true;
    }
    this.display.grow(flights);
  }
}

/** Which of these is worth watching: of the most drones, and of those the newest. @param {any[]} sessions @returns {string | null} */
function best(sessions) {
  const [first] = sessions.toSorted((a, b) => b.drones - a.drones || a.since_s - b.since_s);
  return first ? String(first.session) : null;
}

/** @param {number} seconds */
function duration(seconds) {
  if (seconds < 60) return `${Math.round(seconds)} s`;
  return seconds < 3600 ? `${Math.round(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`;
}
