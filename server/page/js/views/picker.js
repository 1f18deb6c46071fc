// Which run is replayed: attempt and episode, with what there is to download.

import { downloadUrl } from "../api.js";
import { make, number } from "../dom.js";
import { flown, summary } from "./attempt.js";

/** @typedef {import("./attempt.js").Attempt} Attempt */

export class Picker {
  /** @type {Attempt | null} */
  attempt = null;
  episode = 0;
  #attempts = /** @type {Attempt[]} */ ([]);

  /** @param {string} name a or b @param {() => void} onChoose */
  constructor(name, onChoose) {
    const letter = name.toUpperCase();
    this.runs = make("select", { "aria-label": `Run ${letter}` });
    this.episodes = make("select", { "aria-label": `Episode of run ${letter}` });
    this.facts = make("p", { class: "muted" });
    this.downloads = make("p", { class: "downloads" });
    this.box = make("fieldset", { class: `picker run-${name}` }, make("legend", {}, `Run ${letter}`), this.runs, this.episodes, this.facts, this.downloads);
    this.runs.addEventListener("change", () => {
      this.choose(this.runs.value, 0);
      onChoose();
    });
    this.episodes.addEventListener("change", () => {
      this.choose(this.id, Number(this.episodes.value));
      onChoose();
    });
  }

  get id() {
    return this.attempt?.id ?? "";
  }

  /** @param {Attempt[]} attempts */
  offer(attempts) {
    this.#attempts = attempts;
    const options = attempts.map((each) => make("option", { value: each.id, disabled: !flown(each) }, summary(each)));
    this.runs.replaceChildren(make("option", { value: "" }, "none"), ...options);
  }

  /** @param {string} id @param {number} episode */
  choose(id, episode) {
    this.attempt = this.#attempts.find((each) => each.id === id) ?? null;
    this.runs.value = this.id;
    const count = Math.max(1, this.attempt?.episodes ?? 1);
    this.episode = Math.min(count - 1, Math.max(0, Math.trunc(episode)));
    this.detail([]);
    this.episodes.hidden = this.downloads.hidden = this.facts.hidden = !this.attempt;
    this.#links();
    this.end(undefined);
  }

  /** Describes each episode's result. @param {import("./attempt.js").EpisodeResult[]} flights */
  detail(flights) {
    const count = Math.max(1, this.attempt?.episodes ?? 1);
    const how = (/** @type {number} */ i) => (flights[i] ? ` · ${flights[i].failed ?? `score ${number(flights[i].score, 1)}`}` : "");
    this.episodes.replaceChildren(...Array.from({ length: count }, (_, i) => make("option", { value: String(i) }, `Episode ${i + 1} of ${count}${how(i)}`)));
    this.episodes.value = String(this.episode);
  }

  #links() {
    const { id, episode } = this;
    const link = (/** @type {string} */ file, /** @type {string} */ text) => make("a", { href: downloadUrl(id, file), download: "" }, text);
    this.downloads.replaceChildren(link(`log.csv?episode=${episode}`, "Log of this flight"), link("actions.bin", "All actions"));
  }

  /** Shows the end of the episode. @param {string | undefined} how */
  end(how) {
    const { attempt } = this;
    if (!attempt) return;
    const failed = `${attempt.failed ?? 0} of ${attempt.episodes} failed`;
    const ended = how === "time" ? "this one flew to the end" : `this one ${how}`;
    this.facts.textContent = how ? `${failed}; ${ended}` : failed;
  }
}
