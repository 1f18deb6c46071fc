// The pilot's hands: keys, buttons, sticks for thumbs and a gamepad become four sticks.

/** @typedef {{forward: number, left: number, rise: number, turn: number}} Sticks Each from -1 to 1; `turn` to the left. */
/** @typedef {"forward" | "back" | "left" | "right" | "rise" | "sink" | "turnLeft" | "turnRight"} Move */

/** Keys by their place on the keyboard, whatever is printed on them. @type {Record<string, Move>} */
const KEYS = {
  KeyW: "forward",
  ArrowUp: "forward",
  KeyS: "back",
  ArrowDown: "back",
  KeyA: "left",
  ArrowLeft: "left",
  KeyD: "right",
  ArrowRight: "right",
  KeyR: "rise",
  Space: "rise",
  KeyF: "sink",
  ShiftLeft: "sink",
  ShiftRight: "sink",
  KeyQ: "turnLeft",
  KeyE: "turnRight",
};

/** @type {Record<Move, [keyof Sticks, number]>} */
const MOVES = {
  forward: ["forward", 1],
  back: ["forward", -1],
  left: ["left", 1],
  right: ["left", -1],
  rise: ["rise", 1],
  sink: ["rise", -1],
  turnLeft: ["turn", 1],
  turnRight: ["turn", -1],
};

/** So long after a flight a space that was meant for it presses no button. */
const QUIET_MS = 1500;
/** Sticks of gamepads do not come to rest in the middle. */
const DEAD_ZONE = 0.15;

/** @param {number} axis */
function beyondDeadZone(axis) {
  const size = Math.min(1, Math.abs(axis));
  return size < DEAD_ZONE ? 0 : (Math.sign(axis) * (size - DEAD_ZONE)) / (1 - DEAD_ZONE);
}

/** The first gamepad with two sticks. @returns {Gamepad | null} */
export function gamepad() {
  const pads = navigator.getGamepads?.() ?? [];
  return [...pads].find((pad) => pad?.connected && pad.axes.length >= 4) ?? null;
}

export class Controls {
  /** Pressed moves, by the key or button that presses them. @type {Map<string, Move>} */
  #held = new Map();
  /** Positions of the sticks under the thumbs. @type {Partial<Sticks>} */
  #thumbs = {};
  #active = false;
  /** When the flight before ended; keys of sticks have no other meaning then. */
  #ended_ms = -Infinity;
  onEscape = () => {};

  /** @param {HTMLElement} buttons Holds a button for each move. @param {HTMLElement} pads Holds the sticks for thumbs. */
  constructor(buttons, pads) {
    // before anything else on the page hears of it: the same keys have other meanings elsewhere
    document.addEventListener("keydown", (event) => this.#key(event, true), { capture: true });
    document.addEventListener("keyup", (event) => this.#key(event, false), { capture: true });
    // the page gets no event for a key released in another window
    window.addEventListener("blur", () => this.#release());
    for (const button of buttons.querySelectorAll("button")) this.#button(button);
    for (const pad of pads.children) this.#thumb(/** @type {HTMLElement} */ (pad));
  }

  /** @param {boolean} active Whether keys fly. */
  setActive(active) {
    if (this.#active && !active) this.#ended_ms = performance.now();
    this.#active = active;
    this.#release();
  }

  /** Keys have their other meanings again. */
  forget() {
    this.#ended_ms = -Infinity;
  }

  #release() {
    this.#held.clear();
    this.#thumbs = {};
  }

  /** @returns {Sticks} */
  sticks() {
    const sticks = { forward: 0, left: 0, rise: 0, turn: 0 };
    for (const move of new Set(this.#held.values())) {
      const [stick, sign] = MOVES[move];
      sticks[stick] += sign;
    }
    // sticks in mode 2: the right stick moves, the left one turns and rises; down is positive
    const [turn, rise, left, forward] = (gamepad()?.axes ?? [0, 0, 0, 0]).map((axis) => -beyondDeadZone(axis));
    const analogue = { turn, rise, left, forward };
    for (const stick of /** @type {(keyof Sticks)[]} */ (Object.keys(sticks))) {
      sticks[stick] = Math.max(-1, Math.min(1, sticks[stick] + analogue[stick] + (this.#thumbs[stick] ?? 0)));
    }
    return sticks;
  }

  /** @param {KeyboardEvent} event @param {boolean} down */
  #key(event, down) {
    const quiet_ms = performance.now() - this.#ended_ms;
    if (!(this.#active || Number.isFinite(quiet_ms)) || event.ctrlKey || event.altKey || event.metaKey || document.querySelector("dialog[open]")) return;
    const target = event.target instanceof Element ? event.target : document.body;
    if (event.code === "Escape" && down && this.#active) {
      event.preventDefault();
      this.onEscape();
      return;
    }
    const move = KEYS[event.code];
    if (!move || target.closest("select, textarea, input")) return;
    // space presses a button that has the focus, arrows turn a view that was chosen
    if (event.code === "Space" && target.closest("button, a") && quiet_ms > QUIET_MS) return;
    if (!this.#active && target.closest("canvas")) return;
    event.preventDefault();
    event.stopPropagation();
    this.#hold(event.code, move, down && this.#active);
  }

  /** A stick under a thumb: how far it is pushed, as a share of its reach. @param {HTMLElement} pad */
  #thumb(pad) {
    const [across, along] = /** @type {(keyof Sticks)[]} */ ((pad.dataset.sticks ?? "").split(" "));
    const put = (/** @type {number} */ x, /** @type {number} */ y) => {
      const size = Math.max(1, Math.hypot(x, y));
      pad.style.setProperty("--x", String(x / size));
      pad.style.setProperty("--y", String(y / size));
      this.#thumbs[across] = this.#active ? -x / size : 0;
      this.#thumbs[along] = this.#active ? -y / size : 0;
    };
    const follow = (/** @type {PointerEvent} */ event) => {
      if (!pad.hasPointerCapture(event.pointerId)) return;
      const { left, top, width, height } = pad.getBoundingClientRect();
      put((2 * (event.clientX - left)) / width - 1, (2 * (event.clientY - top)) / height - 1);
    };
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      follow(event);
    });
    pad.addEventListener("pointermove", follow);
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(end, () => put(0, 0));
    pad.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** By finger, by mouse, or by space and enter while it has the focus. @param {HTMLButtonElement} button */
  #button(button) {
    const move = /** @type {Move} */ (button.dataset.stick);
    const hold = (/** @type {boolean} */ down) => this.#hold(`button ${move}`, move, down && this.#active);
    button.addEventListener("pointerdown", (event) => {
      button.setPointerCapture(event.pointerId);
      hold(true);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) button.addEventListener(end, () => hold(false));
    const pressed = (/** @type {KeyboardEvent} */ event) => event.code === "Space" || event.code === "Enter";
    button.addEventListener("keydown", (event) => pressed(event) && hold(true));
    button.addEventListener("keyup", (event) => pressed(event) && hold(false));
    // a long press is no wish for a menu
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** @param {string} by @param {Move} move @param {boolean} down */
  #hold(by, move, down) {
    if (down) this.#held.set(by, move);
    else this.#held.delete(by);
  }
}
