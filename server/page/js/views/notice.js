// Notices of errors, visible until the error is over or the visitor closes them.

import { byId, make } from "../dom.js";

/** @param {string} key One subject: a newer notice takes the place of the older one. @param {string | null} message null: it is over. */
export function notice(key, message) {
  const host = byId("notices");
  const old = [...host.children].find((child) => child.dataset.key === key);
  if (message === null) {
    old?.remove();
    return;
  }
  if (old && old.firstChild.textContent === message) return;
  old?.remove();
  const close = make("button", { type: "button", class: "quiet", "aria-label": "Put this notice away", onclick: () => shown.remove() }, "×");
  const shown = make("div", { class: "notice" }, make("span", {}, message), close);
  shown.dataset.key = key;
  host.append(shown);
}

/** @param {string} key @param {unknown} error */
export function failure(key, error) {
  notice(key, error instanceof Error ? error.message : String(error));
}
