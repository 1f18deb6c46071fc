// Which key presses are meant for the page and not for the control that has the focus.

/** No modifier but shift, and the focus is not where keys have a meaning of their own. @param {KeyboardEvent} event */
export function plainKey(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented) return false;
  if (document.querySelector("dialog[open]")) return false;
  const target = event.target instanceof Element ? event.target : document.body;
  if (target.closest("select, textarea, input:not([type=range]):not([type=checkbox])")) return false;
  // space presses the button, follows the link
  return !(event.key === " " && target.closest("button, a, input, summary"));
}
