"""A server for the page, and what is seen of the page in a browser."""

import io
import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys

import numpy as np
import pytest

from common import LIMIT_S, wait

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
CRAZYFLIE = shlex.split(os.environ.get("CRAZYFLIE", "")) or [sys.executable, "-m", "crazyflie_gym"]
PATIENCE_MS = 1000 * LIMIT_S
SCENARIO = "hover-aruco"


# software rendering gives WebGL on machines without a graphics card; nothing of the browser's own reaches the network
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]
# flies circles in a session of its own, as any client would
PILOT = """async () => {
  const socket = new WebSocket(location.origin.replace("http", "ws") + "/ws", "crazyflie.v1");
  await new Promise((open) => (socket.onopen = open));
  let id = 0;
  const ask = (request) => new Promise((answered) => {
    socket.onmessage = (message) => answered(JSON.parse(message.data));
    socket.send(JSON.stringify({ id: ++id, ...request }));
  });
  await ask({ type: "make", env: "Crazyflie-v0", num_envs: 3, options: { autoreset: "same_step" } });
  await ask({ type: "reset", seed: 5 });
  window.flying = true;
  (async () => {
    while (window.flying) {
      const [s, c] = [0.4 * Math.sin(id / 40), 0.4 * Math.cos(id / 40)];
      await ask({ type: "step", action: [0, 1, 2].map(() => [s, c, 0, 0]) });
      await new Promise((later) => setTimeout(later, 20));
    }
    await ask({ type: "close" });
  })();
}"""
# a world of eight that stands still until its only pilot flies: nothing depends on the speed of the machine
CROWD = """async () => {
  const socket = new WebSocket(location.origin.replace("http", "ws") + "/ws", "crazyflie.v1");
  await new Promise((open) => (socket.onopen = open));
  let id = 0;
  const ask = (request) => new Promise((answered) => {
    socket.onmessage = (message) => answered(JSON.parse(message.data));
    socket.send(JSON.stringify({ id: ++id, ...request }));
  });
  const plan = { mission: "swap", seed: 2, options: { drones: 8, max_episode_steps: 2000 } };
  const { session } = await ask({ type: "world", name: "page", deadline_s: 10, ...plan });
  await ask({ type: "join", name: "page" });
  window.fly = async (ticks) => {
    for (let tick = 0; tick < ticks; tick++) await ask({ type: "fly", action: [0, 0, 0, 0] });
  };
  window.leave = () => ask({ type: "leave" });
  return session;
}"""
# which way is up for the vehicle, and how fast it flies, row by row
LEANING = """async (attempt) => {
  const { getReplay } = await import(location.origin + "/js/api.js");
  const { RunView } = await import(location.origin + "/js/scene/run_view.js");
  const view = new RunView();
  [view.flight] = await getReplay(attempt, 0);
  return Array.from({ length: view.flight.rows }, (_, row) => {
    view.update(view.flight.get("t_s", row), { vehicleScale: 2, cone: true, spin: false });
    view.vehicle.updateMatrix();
    const up = view.vehicle.matrix.elements.slice(8, 10).map((part) => part / view.vehicle.scale.z);
    return [...up, view.flight.get("vx", row), view.flight.get("vy", row), view.flight.get("t_s", row)];
  });
}"""

# when two runs, both about the marker, are farthest apart for those who look from the front right: each attempt has
# seeds of its own, and at a moment that is chosen beforehand one vehicle may hide the other
APART_S = """async (attempts) => {
  const { getReplay } = await import(location.origin + "/js/api.js");
  const [a, b] = (await Promise.all(attempts.map((attempt) => getReplay(attempt, 0)))).map(([flight]) => flight);
  const place = (flight, row) => ["x", "y"].map((axis) => flight.get(axis, row));
  const moment = (row) => {
    const [[ax, ay], [bx, by]] = [place(a, row), place(b, row)];
    const isNear = Math.max(...[ax, ay, bx, by].map(Math.abs)) < 0.8;
    return { t_s: a.get("t_s", row), apart_m: isNear ? Math.abs(ax - bx + ay - by) : 0 };
  };
  const moments = Array.from({ length: Math.min(a.rows, b.rows) }, (_, row) => moment(row));
  return moments.reduce((best, now) => (now.apart_m > best.apart_m ? now : best)).t_s.toFixed(2);
}"""


class Server:
    """`crazyflie serve` on a port of its own, or on a given one."""

    def __init__(self, data, port=0):
        command = [*CRAZYFLIE, "serve", "--listen", f"127.0.0.1:{port}", "--data", data]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        line = self.process.stdout.readline()
        assert line.startswith("listening on "), f"{command} said {line!r}"
        self.port = int(line.rsplit(":", 1)[1])
        self.url = f"http://127.0.0.1:{self.port}/"

    def cpu_s(self):
        """Time that it has computed so far."""
        after_name = pathlib.Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(after_name[11]) + int(after_name[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self):
        self.process.terminate()
        assert self.process.wait(LIMIT_S) == 0


def canvas(page):
    """The 3D view as pixels, without what lies over it."""
    cover = """(seen) => document.querySelectorAll("#tools, #readout, #captions, #fly-bar, #fly-buttons")
      .forEach((e) => (e.style.visibility = seen))"""
    image = pytest.importorskip("PIL.Image", reason="the picture is not looked at: pip install pillow")
    page.evaluate(cover, "hidden")
    drawn(page)
    picture = page.locator("#stage canvas").screenshot()
    page.evaluate(cover, "")
    return np.asarray(image.open(io.BytesIO(picture)).convert("RGB")).astype(int)


def obstacles(page):
    """What people with aids would stumble over, as axe-core finds within the page."""
    axe = pytest.importorskip("axe_playwright_python", reason="axe is not asked: pip install axe-playwright-python")
    if not page.evaluate("'axe' in window"):
        page.evaluate((pathlib.Path(axe.__file__).parent / "axe.min.js").read_text())
    found = page.evaluate("axe.run().then(({ violations }) => violations)")
    return [[each["id"], *(node["target"] for node in each["nodes"])] for each in found]


def drawn(page):
    """Waits until all that is drawn now is seen: a frame that was asked for, and the one after it."""
    page.evaluate("new Promise((seen) => requestAnimationFrame(() => requestAnimationFrame(seen)))")


def until(page, expression):
    """Waits. Playwright's own way is forbidden by the page's policy: it evaluates a string within the page."""
    wait(lambda: page.evaluate(expression), expression, pause_s=0.05)


def changed(before, after):
    """How many pixels of two pictures differ."""
    return int((np.abs(before - after).max(axis=-1) > 24).sum())


def canvas_with(page, is_seen, otherwise="the 3D view lacks a part"):
    """The 3D view once it shows something: just opened, it may not yet."""

    def picture():
        view = canvas(page)
        return [view] if is_seen(view) else None

    return wait(picture, otherwise)[0]


def moves(page, before, least=100):
    """Waits until the 3D view differs from a picture of it; the picture then."""
    return canvas_with(page, lambda after: changed(before, after) > least, "the 3D view stands still")


def rgb(page, variable):
    value = page.evaluate(f"getComputedStyle(document.documentElement).getPropertyValue('{variable}').trim()")
    return np.array([int(value[i : i + 2], 16) for i in (1, 3, 5)])


def close_to(pixels, colour, within=40):
    return np.abs(pixels - colour).max(axis=-1) <= within


def blue(pixels):
    """How many pixels are of run A's colour, whatever lies over or under it."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return int(((blue - red > 80) & (blue - green > 40)).sum())


def orange(pixels):
    """The same of run B. Red, which is the x axis and a lost marker, is another colour; so is the yellow nose."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return int(((red - green > 80) & (green - blue > 35)).sum())


def time_s(page):
    return float(page.locator("#time").inner_text().split("/")[0])


def position(page):
    """x, y, z as the table of the moment tells them."""
    row = page.locator("#readout tr", has_text="x, y, z").locator("td").first.inner_text()
    return [float(number.replace("\u2212", "-")) for number in re.findall("[\u2212-]?[0-9.]+", row)]


def settled(page):
    """Waits until a replay's table of the moment is of the time that is shown: it follows a few times a second."""
    shown = "`${Number(document.querySelector('#time').dataset.seconds).toFixed(2)} s`"
    until(page, f"document.querySelector('#readout').innerText.includes({shown})")
    return page


def linked(page):
    """The link to the moment that is shown: the address follows a clock that stands within a moment."""
    until(
        page,
        "Number(document.querySelector('#time').dataset.seconds)"
        " === Number(new URLSearchParams(location.hash.split('?')[1]).get('t'))",
    )
    return page.url.split("/")[-1]


def loaded(page):
    until(page, "document.querySelectorAll('#flight:not([hidden]) .strip').length >= 9")
    until(page, "document.querySelector('#empty').hidden")
    drawn(page)
    notices = page.locator("#notices").inner_text()
    assert notices == "", notices
    return page
