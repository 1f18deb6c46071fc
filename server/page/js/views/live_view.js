// Running sessions, and the one that is watched.

import { getJson } from "../api.js";
import { byId, make } from "../dom.js";
import { Live } from "../live.js";
import { address, here, note } from "../place.js";
import { failure, notice } from "./notice.js";

const POLL_MS = 2000;
const NOBODY = "No session is running. One appears here as soon as a program steps an environment of this server, for example\n"
  + "gymnasium.make(\"Crazyflie-v0\", remote=\"ws://…/ws\").";

export class LiveView {
  #live = new Live();
  /** @type {string | null} */
  #watched = null;
  /** Chosen by a person or the address: not exchanged for another when it ends. */
  #chosen = false;
  #timer = 0;
  #active = false;
  #shown = /** @type {object | null} */ (null);

  /** @param {import("./display.js").Display} display */
  constructor(display) {
    this.display = display;
    this.#live.addEventListener("flight", () => this.#grow());
    this.#live.addEventListener("state", () => notice("live", this.#live.connected ? null : "The connection to the server is lost. Trying again…"));
    this.#live.addEventListener("trouble", (event) => failure("live-data", /** @type {CustomEvent} */ (event).detail));
    document.addEventListener("visibilitychange", () => {
      if (this.#active && !document.hidden) this.#poll();
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
    if (asked !== null) this.#watch(asked);
    await this.#poll();
  }

  leave() {
    this.#active = false;
    clearTimeout(this.#timer);
    this.#live.watch(null);
    this.#watched = null;
    this.#shown = null;
    this.display.say("");
    notice("live", null);
    notice("sessions", null);
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
    if (!this.#chosen && ids.length && !ids.includes(this.#watched ?? "")) this.#watch(ids[0]);
    const gone = this.#watched !== null && !ids.includes(this.#watched);
    if (!sessions.length && this.#watched === null) this.display.say(NOBODY);
    else if (gone) this.display.say(`Session ${this.#watched} has ended.`);
    else this.display.say(this.#live.flight ? "" : "Waiting for the first step of this session…");
    byId("sessions").replaceChildren(...(sessions.length ? sessions.map((session) => this.#entry(session)) : [make("li", { class: "muted" }, "none")]));
  }

  /** @param {any} session */
  #entry({ session, env, num_envs, steps, since_s }) {
    const watched = String(session) === this.#watched;
    const facts = `${num_envs === 1 ? "1 environment" : `${num_envs} environments, the first is shown`} · ${Number(steps).toLocaleString()} steps · ${duration(since_s)}`;
    const link = make("a", { href: address("live", { session }), "aria-current": watched ? "true" : undefined }, make("strong", {}, env), make("span", { class: "muted" }, facts));
    link.addEventListener("click", () => note({}));
    return make("li", {}, link);
  }

  /** @param {string} session */
  #watch(session) {
    if (session === this.#watched) return;
    this.#watched = session;
    this.#shown = null;
    this.display.show([], { live: true });
    this.#live.watch(session);
  }

  #grow() {
    const { flight } = this.#live;
    if (!flight || here().view !== "live") return;
    if (flight !== this.#shown) {
      this.display.say("");
      this.display.show([flight], { live: true, aim: this.#shown === null });
      this.#shown = flight;
    }
    this.display.grow(flight.lastTime);
  }
}

/** @param {number} seconds */
function duration(seconds) {
  if (seconds < 60) return `${Math.round(seconds)} s`;
  return seconds < 3600 ? `${Math.round(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`;
}
