"""The page of `crazyflie serve` in a real browser: it draws, it moves, it needs no mouse and fits on a phone."""

import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

np = pytest.importorskip("numpy")
sync_api = pytest.importorskip("playwright.sync_api", reason="the page is not tested: pip install playwright")
Image = pytest.importorskip("PIL.Image", reason="the page is not tested: pip install pillow")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("the page is not tested: no chromium here (apt-get install chromium)", allow_module_level=True)

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
CRAZYFLIE = shlex.split(os.environ.get("CRAZYFLIE", "")) or [sys.executable, "-m", "crazyflie_gym"]
SCENARIO = "hover-aruco"
PATIENCE_MS = 30_000
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


class Server:
    """`crazyflie serve` on a port of its own, or on a given one."""

    def __init__(self, data, port=0):
        command = [*CRAZYFLIE, "serve", "--listen", f"127.0.0.1:{port}", "--data", data]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        line = self.process.stdout.readline()
        assert line.startswith("listening on "), f"{command} said {line!r}"
        self.port = int(line.rsplit(":", 1)[1])
        self.url = f"http://127.0.0.1:{self.port}/"

    def stop(self):
        self.process.terminate()
        assert self.process.wait(15) == 0


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = str(tmp_path_factory.mktemp("page") / "bench.sqlite")
    for controller in ["thesis-pid", "stock-pid"]:
        command = [*CRAZYFLIE, "submit", "--controller", controller, "--scenario", SCENARIO, "--data", path]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=120)
    return path


@pytest.fixture(scope="module")
def server(data):
    server = Server(data)
    yield server
    server.stop()


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def visit(browser, server):
    """Opens the page; whatever the browser finds wrong with it fails the test."""
    wrong, pages = [], []

    def open_page(place="", url=server.url, faultless=True, **context):
        page = browser.new_page(**{"viewport": {"width": 1000, "height": 660}, **context})
        page.set_default_timeout(PATIENCE_MS)
        pages.append(page)
        if faultless:
            page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
            page.on("pageerror", lambda error: wrong.append(str(error)))
            page.on("requestfailed", lambda request: wrong.append(f"{request.url}: {request.failure}"))
            page.on("response", lambda r: wrong.append(f"{r.url}: {r.status}") if r.status >= 400 else None)
            page.on("request", lambda r: None if r.url.startswith(url) else wrong.append(f"elsewhere: {r.url}"))
        page.goto(url + place)
        return page

    yield open_page
    for page in pages:
        page.close()
    # swiftshader is slow at reading back, and says so when a screenshot is taken
    assert [what for what in wrong if "GPU stall due to ReadPixels" not in what] == []


@pytest.fixture(scope="module")
def attempts(browser, server):
    """Ids of the attempts with the new and the old gains."""
    page = browser.new_page()
    page.goto(server.url)
    listed = page.evaluate(f"fetch('api/v1/attempts?scenario={SCENARIO}').then((answer) => answer.json())")
    page.close()
    return [row["id"] for row in listed]


def canvas(page):
    """The 3D view as pixels, without what lies over it."""
    cover = (
        "(seen) => document.querySelectorAll('#tools, #readout, #captions').forEach((e) => (e.style.visibility = seen))"
    )
    page.evaluate(cover, "hidden")
    page.wait_for_timeout(150)
    picture = page.locator("#stage canvas").screenshot()
    page.evaluate(cover, "")
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)


def until(page, expression):
    """Waits. Playwright's own way is forbidden by the page's policy: it evaluates a string within the page."""
    end = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"in vain: {expression}"
        page.wait_for_timeout(50)


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
    page.wait_for_timeout(250)
    row = page.locator("#readout tr", has_text="x, y, z").locator("td").first.inner_text()
    return [float(number.replace("\u2212", "-")) for number in re.findall("[\u2212-]?[0-9.]+", row)]


def loaded(page):
    until(page, "document.querySelectorAll('#flight:not([hidden]) .strip').length === 9")
    until(page, "document.querySelector('#empty').hidden")
    page.wait_for_timeout(400)
    assert page.locator("#notices").inner_text() == ""
    return page


def test_served_with_a_strict_policy(visit, server):
    page = visit("#board")
    answer = page.request.get(server.url)
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "script-src 'self'" in policy and "unsafe" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"
    again = page.request.get(server.url, headers={"If-None-Match": answer.headers["etag"]})
    assert again.status == 304 and again.body() == b""
    assert page.request.get(server.url + "../Cargo.toml").status == 404
    assert page.request.post(server.url).status == 405
    # the policy is in force: what it forbids does not run
    strange = visit("#board", faultless=False)
    strange.evaluate(
        "document.body.append(Object.assign(document.createElement('script'), { text: 'window.ran = 1' }))"
    )
    assert strange.evaluate("window.ran") is None


def test_live_draws_what_flies(visit):
    pilot = visit("#board")
    pilot.evaluate(PILOT)
    page = loaded(visit("#live"))
    assert "Crazyflie-v0" in page.locator("#sessions a[aria-current]").inner_text()
    before, seen = canvas(page), position(page)
    page.wait_for_timeout(900)
    after, later = canvas(page), position(page)
    assert seen != later, "the numbers of the moment stand still"
    assert (np.abs(before - after).max(axis=-1) > 24).sum() > 100, "the 3D view stands still"
    sky = close_to(after, rgb(page, "--sky"), 3)
    height, width = sky.shape
    thirds = [
        after[y * height // 3 : (y + 1) * height // 3, x * width // 3 : (x + 1) * width // 3]
        for y in range(3)
        for x in range(3)
    ]
    drawn = [len(np.unique(part.reshape(-1, 3), axis=0)) for part in thirds]
    print(f"colours in nine parts of the view: {drawn}; not sky: {1 - sky.mean():.0%}")
    assert sum(count > 20 for count in drawn) >= 5 and 0.2 < 1 - sky.mean() < 0.98
    # another environment of the batch
    page.get_by_label("Environment that is watched").select_option("2")
    until(page, "location.hash.includes('env=2')")
    loaded(page)
    pilot.evaluate("window.flying = false")
    until(page, "document.querySelector('#empty').textContent.includes('has ended')")


def test_nothing_to_show_is_said(visit):
    page = visit("#live")
    until(page, "document.querySelector('#empty').textContent.includes('No session is running')")
    page.goto(page.url.split("#")[0] + "#replay?scenario=wind")
    until(page, "document.querySelector('#empty').textContent.includes('No attempt')")


def test_replay_moves(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}"))
    start, at_start, line = (
        canvas(page),
        position(page),
        page.locator(".now").first.evaluate("(e) => e.style.transform"),
    )
    page.get_by_role("button", name="Play", exact=True).click()
    until(page, "parseFloat(document.querySelector('#time').textContent) > 2")
    page.get_by_role("button", name="Pause").click()
    assert position(page) != at_start
    assert page.locator(".now").first.evaluate("(e) => e.style.transform") != line
    assert (np.abs(canvas(page) - start).max(axis=-1) > 24).sum() > 200
    # a link to this moment shows this moment
    until(page, "location.hash.includes('t=')")
    other = loaded(visit(page.url.split("/")[-1]))
    assert abs(time_s(other) - time_s(page)) < 0.02 and position(other) == position(page)


LEANING = """async (attempt) => {
  const { getReplay } = await import(location.origin + "/js/api.js");
  const { RunView } = await import(location.origin + "/js/scene/run_view.js");
  const view = new RunView();
  view.flight = await getReplay(attempt, 0);
  return Array.from({ length: view.flight.rows }, (_, row) => {
    view.update(view.flight.get("t_s", row), { vehicleScale: 2, cone: true, spin: false });
    view.vehicle.updateMatrix();
    const up = view.vehicle.matrix.elements.slice(8, 10).map((part) => part / view.vehicle.scale.z);
    return [...up, view.flight.get("vx", row), view.flight.get("vy", row), view.flight.get("t_s", row)];
  });
}"""


def test_the_vehicle_leans_where_it_accelerates(visit, attempts):
    up_x, up_y, vx, vy, t = np.array(visit("#board").evaluate(LEANING, attempts[1])).T
    for name, up, v in [("x", up_x, vx), ("y", up_y, vy)]:
        # m/s^2 per radian of lean: gravity
        slope, correlation = np.polyfit(up, np.gradient(v, t), 1)[0], np.corrcoef(up, np.gradient(v, t))[0, 1]
        print(f"{name}: {slope:.2f} m/s^2 per unit of lean, correlation {correlation:.3f}")
        assert 8.5 < slope < 11 and correlation > 0.95


def test_speed_is_what_it_says(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}"))
    for speed in ["0.5", "4"]:
        page.locator("#speed").select_option(speed)
        page.keyboard.press("Home")
        page.locator("#play").click()
        page.wait_for_timeout(300)
        begun, from_s = time.monotonic(), time_s(page)
        page.wait_for_timeout(1200)
        ratio = (time_s(page) - from_s) / (time.monotonic() - begun)
        page.locator("#play").click()
        print(f"at x{speed}: {ratio:.2f} seconds of flight per second")
        assert 0.6 * float(speed) < ratio < 1.25 * float(speed)


def test_keys(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}"))
    body = page.locator("body")
    page.keyboard.press("ArrowRight")
    assert time_s(page) == pytest.approx(0.1)
    page.keyboard.press("Shift+ArrowRight")
    assert time_s(page) == pytest.approx(1.1)
    page.keyboard.press(",")
    assert time_s(page) == pytest.approx(1.08)
    page.keyboard.press("Home")
    page.keyboard.press("Space")
    until(page, "parseFloat(document.querySelector('#time').textContent) > 0.1")
    page.keyboard.press("Space")
    stopped = time_s(page)
    page.wait_for_timeout(300)
    assert time_s(page) == stopped
    page.keyboard.press("]")
    assert page.locator("#speed").input_value() == "2"
    page.keyboard.press("?")
    assert page.get_by_role("dialog").is_visible()
    page.keyboard.press("Escape")
    # from the first link on, tab reaches everything, and where it is can be seen
    body.focus()
    page.evaluate("window.outline = () => getComputedStyle(document.activeElement).outlineStyle")
    reached = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        at = page.evaluate("[document.activeElement.id || document.activeElement.tagName, outline()]")
        reached.add(at[0])
        assert at[0] == "BODY" or at[1] != "none", f"no focus to be seen on {at[0]}"
    assert {"CANVAS", "play", "scrub", "speed", "view-home", "toggle-cone", "replay-scenario"} <= reached
    # arrows turn the view that has the focus, and leave the time alone
    before, at_s = canvas(page), time_s(page)
    page.locator("#stage canvas").focus()
    page.keyboard.press("ArrowLeft")
    assert (np.abs(canvas(page) - before).max(axis=-1) > 24).mean() > 0.01 and time_s(page) == at_s


def test_two_runs_side_by_side(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&b={attempts[1]}&t=4"))
    assert page.locator("#legend .run-a, #legend .run-b").count() == 2
    assert page.locator("#readout th.run-b").is_visible()
    together = canvas(page)
    assert blue(together) > 80 and orange(together) > 80
    page.keyboard.press("v")
    page.wait_for_timeout(300)
    apart = canvas(page)
    half = apart.shape[1] // 2
    left, right = apart[:, :half], apart[:, half:]
    counts = [blue(left), orange(left), blue(right), orange(right)]
    print(f"pixels of run A and B: left {counts[:2]}, right {counts[2:]}")
    assert counts[0] > 80 and counts[1] < 20 and counts[2] < 20 and counts[3] > 80
    assert "view=split" in page.url
    # one clock
    page.locator("#readout").get_by_text("time").wait_for()
    times = page.locator("#readout tr", has_text="time").locator("td").all_inner_texts()
    assert times == ["4.00 s", "4.00 s"]


def test_leaderboard(visit):
    page = visit(f"#board?scenario={SCENARIO}")
    table = page.get_by_role("table", name="Leaderboard")
    rows = table.get_by_role("row")
    rows.nth(2).wait_for()
    assert page.locator("#notices").inner_text() == ""
    assert rows.count() == 3 and "thesis-pid" in rows.nth(1).inner_text()
    scores = [float(rows.nth(i).locator("td.score strong").inner_text()) for i in (1, 2)]
    assert scores[0] > scores[1]
    rows.nth(1).get_by_role("button", name="Verify").click()
    rows.nth(1).get_by_text("same bits").wait_for()
    assert "This browser checked the signature" in rows.nth(1).locator(".verdict").get_attribute("title")
    page.get_by_role("button", name="Show every attempt").click()
    every = page.get_by_role("table", name="Every attempt").get_by_role("row")
    every.nth(2).wait_for()
    assert every.count() == 3
    for i in (1, 2):
        rows.nth(i).get_by_role("checkbox").check()
    page.get_by_role("link", name="Compare the two").click()
    loaded(page)
    assert page.locator("#legend .run-b").count() == 1


def test_downloads(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&ea=3"))
    with page.expect_download() as log:
        page.get_by_role("link", name="Log of this flight").click()
    lines = Path(log.value.path()).read_text().splitlines()
    assert lines[0].startswith("t_s,") and len(lines) > 100
    with page.expect_download() as actions:
        page.get_by_role("link", name="All actions").click()
    assert len(Path(actions.value.path()).read_bytes()) % (4 * 4 * 20) == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_phone(visit, attempts, scheme):
    views = ["#live", f"#board?scenario={SCENARIO}&all=1", f"#replay?a={attempts[0]}&b={attempts[1]}"]
    for view in views:
        page = visit(view, viewport={"width": 360, "height": 740}, color_scheme=scheme, has_touch=True, is_mobile=True)
        page.wait_for_timeout(1200)
        assert page.evaluate("document.documentElement.scrollWidth") <= 360, f"{view} is wider than a phone"
        beyond = page.evaluate(
            "[...document.querySelectorAll('button, a, select, input, td, h1')].filter((e) => e.checkVisibility() &&"
            " !e.closest('.skip') && e.getBoundingClientRect().right > 361).map((e) => e.outerHTML.slice(0, 80))"
        )
        assert beyond == []
        brightness = page.evaluate("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
        assert (np.mean(brightness[:3]) > 128) == (scheme == "light")


def test_errors_are_shown_and_the_server_may_come_back(visit, data):
    server = Server(data)
    page = visit("#replay?a=nobody", url=server.url, faultless=False)
    page.locator("#notices", has_text="The server says").wait_for()
    page.goto(server.url + "#live")
    until(page, "document.querySelector('#empty').textContent.includes('No session is running')")
    server.stop()
    page.locator("#notices", has_text="does not answer").wait_for()
    server = Server(data, server.port)
    page.locator("#notices", has_text="does not answer").wait_for(state="detached")
    server.stop()


def test_draws_only_when_something_changes(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}"))
    page.evaluate("""() => {
      window.frames_drawn = 0;
      const { clear } = WebGL2RenderingContext.prototype;
      WebGL2RenderingContext.prototype.clear = function (...what) {
        window.frames_drawn += 1;
        return clear.apply(this, what);
      };
    }""")
    page.wait_for_timeout(300)
    idle = page.evaluate("window.frames_drawn")
    page.wait_for_timeout(700)
    assert page.evaluate("window.frames_drawn") == idle, "it draws though nothing changes"
    page.locator("#play").click()
    page.wait_for_timeout(700)
    assert page.evaluate("window.frames_drawn") > idle
