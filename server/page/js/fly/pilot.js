// A pilot of one drone of a shared world, as docs/protocol.md describes it: world, join, fly, leave.

const PROTOCOL = "crazyflie.v1";
/** Actions that may be under way. Replies take the time of the way to the server, which must not slow the world down. */
const MOST_UNDER_WAY = 25;
/** A server that does not answer within this time is given up. */
const PATIENCE_MS = 8000;

/** Errors that only say that the flight is over: it ended in a tick that went without an action of ours. */
const ENDS = new Set(["drone_ended", "world_over"]);

/** Address of a WebSocket of this server. @param {string} path */
export function socketUrl(path) {
  const url = new URL(path, location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.hash = "";
  return url;
}

/** Says `flown` with the reply to each action in `detail`, and `over` once, with what went wrong or null. */
export class Pilot extends EventTarget {
  #id = 0;
  #over = false;
  /** Name of the world, once it is founded. @type {string | undefined} */
  world;
  /** Promises that await replies, by request. @type {Map<number, {resolve: (reply: any) => void, reject: (error: Error) => void}>} */
  #asked = new Map();
  #underWay = 0;
  /** @type {WebSocket | null} */
  #socket = null;

  /** Founds the world and takes the drone. @param {any} request @param {number} drone @returns {Promise<{world: any, joined: any}>} */
  async begin(request, drone) {
    const socket = new WebSocket(socketUrl("ws"), PROTOCOL);
    this.#socket = socket;
    socket.onmessage = (message) => this.#take(JSON.parse(message.data));
    await new Promise((open, failed) => {
      const timer = setTimeout(() => failed(new Error("The server does not answer.")), PATIENCE_MS);
      let lost = "The server does not accept the connection.";
      socket.onopen = () => {
        clearTimeout(timer);
        lost = "The connection to the server is lost.";
        open(undefined);
      };
      socket.onclose = () => {
        clearTimeout(timer);
        failed(new Error(lost));
        this.#end(new Error(lost));
      };
    });
    const world = await this.#ask(request);
    this.world = request.name;
    const joined = await this.#ask({ type: "join", name: request.name, drone });
    return { world, joined };
  }

  /** Sends the action of this tick, unless too many wait for their replies. @param {number[]} action */
  fly(action) {
    if (this.#over || this.#underWay >= MOST_UNDER_WAY || this.#socket?.readyState !== WebSocket.OPEN) return;
    this.#underWay += 1;
    this.#send({ type: "fly", action });
  }

  /** Gives the drone to the autopilot. Closing the connection does so too, which is all that a page about to vanish can do. */
  leave() {
    this.#end(null);
  }

  /** @param {any} request @returns {Promise<any>} */
  #ask(request) {
    return new Promise((resolve, reject) => {
      if (this.#over) reject(new Error("The flight was ended."));
      this.#asked.set(this.#send(request), { resolve, reject });
    });
  }

  /** @param {any} request @returns {number} The id of the request. */
  #send(request) {
    this.#id += 1;
    this.#socket?.send(JSON.stringify({ id: this.#id, ...request }));
    return this.#id;
  }

  /** @param {any} reply */
  #take(reply) {
    const asked = this.#asked.get(reply.id);
    this.#asked.delete(reply.id);
    const problem = reply.type === "error" ? new Error(`Error of the server: ${reply.message}`) : null;
    if (asked) {
      if (problem) asked.reject(problem);
      else asked.resolve(reply);
    } else if (problem) {
      this.#end(ENDS.has(reply.code) ? null : problem);
    } else if (reply.type === "flown") {
      this.#underWay -= 1;
      if (this.#over) return;
      this.dispatchEvent(new CustomEvent("flown", { detail: reply }));
      if (!reply.flying) this.#end(null);
    }
  }

  /** @param {Error | null} problem */
  #end(problem) {
    if (this.#over) return;
    this.#over = true;
    for (const { reject } of this.#asked.values()) reject(problem ?? new Error("The flight was ended."));
    this.#asked.clear();
    this.#socket?.close(1000);
    this.dispatchEvent(new CustomEvent("over", { detail: problem }));
  }
}
