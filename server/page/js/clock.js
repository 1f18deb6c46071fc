// The clock of a replay. Both runs follow it.

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16];

/** A slow machine draws few frames, but keeps time; after a pause of the browser the clock goes on from where it was. */
const LONGEST_FRAME_S = 0.5;

/** Time that can be played, paused and set; says `change` whenever something about it is new. */
export class Clock extends EventTarget {
  time_s = 0;
  end_s = 0;
  speed = 1;
  playing = false;
  #last_ms = 0;

  /** Whole milliseconds, which a link keeps: it shows again what was seen. @param {number} time_s */
  seek(time_s) {
    this.time_s = Math.min(this.end_s, Math.max(0, Math.round(time_s * 1000) / 1000));
    this.#tell();
  }

  play() {
    if (this.playing || this.end_s <= 0) return;
    if (this.time_s >= this.end_s - 1e-6) this.time_s = 0;
    this.playing = true;
    this.#last_ms = performance.now();
    requestAnimationFrame(this.#frame);
    this.#tell();
  }

  pause() {
    this.playing = false;
    this.seek(this.time_s);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** @param {number} speed */
  setSpeed(speed) {
    this.speed = speed;
    this.#tell();
  }

  /** One step along the list of speeds. @param {1 | -1} direction */
  changeSpeed(direction) {
    const at = SPEEDS.indexOf(this.speed) + direction;
    if (SPEEDS[at]) this.setSpeed(SPEEDS[at]);
  }

  /** The browser calls this while the page can be seen, and not otherwise: a hidden page stands still. */
  #frame = (/** @type {number} */ now_ms) => {
    if (!this.playing) return;
    const passed_s = Math.min(LONGEST_FRAME_S, Math.max(0, (now_ms - this.#last_ms) / 1000));
    this.#last_ms = now_ms;
    this.time_s = Math.min(this.end_s, this.time_s + passed_s * this.speed);
    if (this.time_s >= this.end_s) this.playing = false;
    else requestAnimationFrame(this.#frame);
    this.#tell();
  };

  #tell() {
    this.dispatchEvent(new Event("change"));
  }
}
