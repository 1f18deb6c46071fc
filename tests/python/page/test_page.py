"""The page of `crazyflie serve` in a real browser: it draws, it moves, it needs no mouse and fits on a phone."""

import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from browsing import (
    CRAZYFLIE,
    FLAGS,
    LEANING,
    PATIENCE_MS,
    PILOT,
    Server,
    blue,
    canvas,
    close_to,
    loaded,
    orange,
    position,
    rgb,
    time_s,
    until,
)

sync_api = pytest.importorskip("playwright.sync_api", reason="the page is not tested: pip install playwright")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("the page is not tested: no chromium here (apt-get install chromium)", allow_module_level=True)

SCENARIO = "hover-aruco"


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
    # one clock
    times = page.locator("#readout tr", has_text="time").locator("td").all_inner_texts()
    assert times == ["4.00 s", "4.00 s"]
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
