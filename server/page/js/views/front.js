// Ways to take part: this server's address, and three clients.

import { byId } from "../dom.js";
import { socketUrl } from "../fly/pilot.js";

const SAID_MS = 2500;

/** @param {string} url @returns {Record<string, string>} Text by the id of its element. */
function texts(url) {
  return {
    address: url,
    "way-python": [
      "import gymnasium",
      "import crazyflie_gym",
      "",
      `env = gymnasium.make("Crazyflie-v0", remote="${url}")`,
      "observation, info = env.reset(seed=1)",
      "for _ in range(500):",
      "    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())",
      "    if terminated or truncated:",
      "        observation, info = env.reset()",
    ].join("\n"),
    "way-shell": `crazyflie bench submit --controller thesis-pid --scenario hover-aruco \\\n  --server ${url} --token-file token.txt`,
    "way-any": ['{"id": 1, "type": "make", "env": "Crazyflie-v0"}', '{"id": 2, "type": "reset", "seed": 1}', '{"id": 3, "type": "step", "action": [0, 0, 0, 0]}'].join("\n"),
  };
}

/** Puts text on the clipboard; where the browser forbids that, selects it. @param {HTMLElement} element @returns {Promise<string>} What was done. */
async function copy(element) {
  try {
    await navigator.clipboard.writeText(element.textContent ?? "");
    return "Copied";
  } catch {
    getSelection()?.selectAllChildren(element);
    return "Selected: press Ctrl C";
  }
}

/** Fills in the address, and what copies it. */
export function front() {
  for (const [id, text] of Object.entries(texts(socketUrl("ws").href))) byId(id).textContent = text;
  for (const button of document.querySelectorAll("button[data-copies]")) {
    if (button instanceof HTMLButtonElement) copies(button);
  }
}

/** @param {HTMLButtonElement} button */
function copies(button) {
  const said = document.createElement("span");
  said.setAttribute("role", "status");
  said.className = "muted";
  button.after(said);
  button.setAttribute("aria-label", button.dataset.copies === "address" ? "Copy the address" : "Copy the text above");
  button.addEventListener("click", async () => {
    said.textContent = await copy(byId(button.dataset.copies ?? ""));
    setTimeout(() => (said.textContent = ""), SAID_MS);
  });
}
