"""The page of `crazyflie serve` in a real browser: it draws, it tells, and it fits on a phone."""

import json
import socket
import subprocess

import numpy as np
import pytest
from browsing import (
    APART_S,
    CRAZYFLIE,
    CROWD,
    PILOT,
    SCENARIO,
    Server,
    blue,
    canvas,
    canvas_with,
    changed,
    close_to,
    loaded,
    moves,
    obstacles,
    orange,
    position,
    rgb,
    until,
)

from common import wait


def test_served_with_a_strict_policy(visit, server):
    page = visit("#board")
    answer = page.request.get(server.url)
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "script-src 'self'" in policy and "unsafe" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"
    packed = page.request.get(server.url + "js/main.js", headers={"Accept-Encoding": "gzip"})
    assert packed.headers["content-encoding"] == "gzip" and "import" in packed.text()
    for path in ("api/v1/vehicles", "healthz", "nowhere", "api/v1/nowhere"):
        assert page.request.get(server.url + path).headers["x-content-type-options"] == "nosniff", path
    assert page.request.get(server.url + "api/v1/nowhere").json()["code"] == "not_found"
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
    wait(lambda: position(page) != seen, "the numbers of the moment stand still")
    moves(page, before)

    def is_drawn():
        after = canvas(page)
        sky = close_to(after, rgb(page, "--sky"), 3)
        height, width = sky.shape
        thirds = [
            after[y * height // 3 : (y + 1) * height // 3, x * width // 3 : (x + 1) * width // 3]
            for y in range(3)
            for x in range(3)
        ]
        drawn = [len(np.unique(part.reshape(-1, 3), axis=0)) for part in thirds]
        print(f"colours in nine parts of the view: {drawn}; not sky: {1 - sky.mean():.0%}")
        return sum(count > 20 for count in drawn) >= 5 and 0.2 < 1 - sky.mean() < 0.98

    wait(is_drawn, "most of the view is empty")
    # another environment of the batch
    page.get_by_label("Environment that is watched").select_option("2")
    until(page, "location.hash.includes('env=2')")
    loaded(page)
    pilot.evaluate("window.flying = false")
    until(page, "document.querySelector('#empty').textContent.includes('has ended')")


def test_live_shows_most_drones_first_and_goes_on_when_they_end(visit):
    pilot, crowd = visit("#board"), visit("#board")
    pilot.evaluate(PILOT)
    session = crowd.evaluate(CROWD)
    crowd.evaluate("window.fly(5)")
    page = visit("#live")
    watched = page.locator("#sessions a[aria-current]")
    until(page, "document.querySelector('#sessions a[aria-current]')?.textContent.includes('8 drones')")
    # a link to a session that is over does not stay there either
    linked = visit(f"#live?session={session}")
    crowd.evaluate("window.leave()")
    for each in (page, linked):
        until(each, "document.querySelector('#sessions a[aria-current]')?.textContent.includes('3 environments')")
        loaded(each)
    assert "session" not in linked.url and watched.count() == 1
    pilot.evaluate("window.flying = false")


def test_a_shared_world_is_drawn_with_all_its_drones(visit):
    pilot = visit("#board")
    session = pilot.evaluate(CROWD)
    page = visit(f"#live?session={session}")
    until(page, "document.querySelectorAll('#flight:not([hidden]) .strip').length === 6")
    assert "world page, 8 drones" in page.locator("#sessions a[aria-current]").inner_text()
    pilot.evaluate("window.fly(100)")
    until(page, "document.querySelector('#empty').hidden")
    # each drone has a hue of its own: vehicles and trails
    hues = "[...document.querySelectorAll('#legend button')].map((e) => getComputedStyle(e, '::before').borderTopColor)"
    until(page, f"new Set({hues}).size === 8")
    wanted = [np.array([int(part) for part in text[4:-1].split(",")]) for text in page.evaluate(hues)]

    def all_drawn():
        # trails grow, and a pilot that is silent for long loses its seat
        pilot.evaluate("window.fly(5)")
        view = canvas(page)
        pixels = [int(close_to(view, colour, 30).sum()) for colour in wanted]
        print(f"pixels of each drone's colour: {pixels}")
        return [view] if min(pixels) > 10 else None

    before = wait(all_drawn, "not all drones are drawn")[0]
    readout = page.locator("#readout").inner_text()
    pilot.evaluate("window.fly(50)")
    moves(page, before)
    later = wait(lambda: (text := page.locator("#readout").inner_text()) != readout and text, "the numbers stand still")
    assert "8 of 8" in later and "separation now" in later
    until(page, "document.querySelector('#charts figcaption').innerText.includes('separation')")
    now_m, least_m = (
        float(row.split("\t")[1].split()[0]) for row in later.splitlines() if "separation" in row or "least" in row
    )
    print(f"{now_m} m apart now, {least_m} m at least so far")
    assert 0.1 < least_m <= now_m < 2.5
    pilot.evaluate("window.leave()")
    until(page, "document.querySelector('#empty').textContent.includes('has ended')")


def test_nothing_to_show_is_said(visit):
    page = visit("#live")
    until(page, "document.querySelector('#sessions').textContent.includes('No session is running')")
    page.goto(page.url.split("#")[0] + "#replay?scenario=wind")
    until(page, "document.querySelector('#empty').textContent.includes('No attempt')")


def test_the_leaderboard_opens_where_most_teams_are(visit):
    page = visit("#board")
    page.get_by_role("table", name="Leaderboard").wait_for()
    chosen = "[...document.querySelector('#board-scenario').selectedOptions].map((option) => option.textContent)"
    assert page.evaluate(chosen) == ["Hover over a marker \u00b7 1 team"]
    assert page.locator("#board-scenario").input_value().startswith(SCENARIO)
    assert "thesis-pid" in page.locator("#overview").inner_text()


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


def test_a_run_of_several_drones_is_replayed_whole(visit, data):
    command = [*CRAZYFLIE, "bench", "submit", "--data", data, "--json"]
    flown = subprocess.run(
        [*command, "--controller", "lqr", "--collision-avoidance", "--scenario", "swap-eight"],
        check=True,
        capture_output=True,
    )
    attempt = json.loads(flown.stdout)["id"]
    page = visit(f"#replay?scenario=swap-eight&a={attempt}&t=4.5")
    until(page, "document.querySelector('#readout').innerText.includes('8 of 8')")
    names = page.locator("#legend button").all_inner_texts()
    assert names == [f"drone {i}" for i in range(8)] and "separation" in page.locator("#charts").inner_text()
    assert page.locator("#notices").inner_text() == ""
    # one of them, with its own charts and numbers, among pale others; and all again
    all_of_them = canvas(page)
    page.get_by_role("button", name="drone 3").click()
    alone = page.evaluate("document.querySelector('#legend [aria-pressed=true]').textContent")
    assert alone == "drone 3" and page.locator(".strip").count() == 9
    assert "x, y, z" in page.locator("#readout").inner_text() and changed(all_of_them, canvas(page)) > 500
    page.get_by_role("button", name="drone 3").click()
    assert "8 of 8" in page.locator("#readout").inner_text() and page.locator(".strip").count() == 6
    assert changed(all_of_them, canvas(page)) < 50
    # one of two runs is shown, and a notice names it
    page.goto(page.url.split("#")[0] + f"#replay?scenario=swap-eight&a={attempt}&b={attempt}&eb=1")
    until(page, "document.querySelector('#notices').innerText.includes('run A')")
    page.goto(page.url.split("#")[0] + f"#board?scenario={SCENARIO}")
    until(page, "document.querySelector('#notices').innerText === ''")


# condition of a complete view
SHOWN = {
    "#live": "document.querySelector('#sessions').textContent.includes('No session is running')",
    "#fly": "!document.querySelector('#fly-start').hidden && document.querySelector('#flown').textContent !== ''",
    "#board": "document.querySelectorAll('table tbody tr').length >= 4",
    "#replay": "document.querySelectorAll('#flight:not([hidden]) .strip').length >= 9",
    "#tuner": "document.querySelectorAll('#tuner-plots .strip canvas').length === 4",
}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_phone(visit, attempts, scheme):
    views = ["#live", "#fly", f"#board?scenario={SCENARIO}&all=1", f"#replay?a={attempts[0]}&b={attempts[1]}"]
    for view in views:
        page = visit(view, viewport={"width": 360, "height": 740}, color_scheme=scheme, has_touch=True, is_mobile=True)
        until(page, SHOWN[view.split("?")[0]])
        assert page.evaluate("document.documentElement.scrollWidth") <= 360, f"{view} is wider than a phone"
        beyond = page.evaluate(
            "[...document.querySelectorAll('button, a, select, input, td, h1')].filter((e) => e.checkVisibility() &&"
            " !e.closest('.skip') && e.getBoundingClientRect().right > 361).map((e) => e.outerHTML.slice(0, 80))"
        )
        assert beyond == []
        brightness = page.evaluate("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
        assert (np.mean(brightness[:3]) > 128) == (scheme == "light")
        # four pages that draw at once are slow
        page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(visit, attempts, scheme):
    both = f"a={attempts[0]}&b={attempts[1]}"
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    for shape in ({}, phone):
        for view in ["#live", "#fly", f"#board?scenario={SCENARIO}&all=1", f"#replay?{both}&t=1", "#tuner"]:
            page = visit(view, color_scheme=scheme, **shape)
            until(page, SHOWN[view.split("?")[0]])
            assert obstacles(page) == [], view
            page.get_by_role("button", name="Help").click()
            assert obstacles(page) == [], f"{view}, its dialog"
            if view == "#fly":
                page.keyboard.press("Escape")
                page.get_by_role("button", name="Take off").click()
                until(page, "document.querySelectorAll('.strip').length === 6")
                assert obstacles(page) == [], "in flight"
            page.close()


def test_without_webgl_flights_are_seen_from_above(visit, attempts):
    # three.js says on the console that there is none
    page = visit("#board", faultless=False)
    broken = []
    page.on("pageerror", lambda error: broken.append(str(error)))
    page.add_init_script("""(() => {
      const { getContext } = HTMLCanvasElement.prototype;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
        return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...more);
      };
    })()""")
    t_s = page.evaluate(APART_S, attempts[:2])
    page.goto(page.url.split("#")[0] + f"#replay?a={attempts[0]}&b={attempts[1]}&t={t_s}")
    page.reload()
    # a run that flies far away makes both vehicles small
    before = canvas_with(loaded(page), lambda view: blue(view) > 8 and orange(view) > 8)
    page.keyboard.press("Shift+ArrowRight")
    assert changed(before, canvas(page)) > 20
    page.get_by_role("link", name="Fly", exact=True).click()
    page.get_by_role("button", name="Take off").click()
    until(page, "document.querySelector('#fly-state').textContent.includes('You fly')")
    page.keyboard.press("Escape")
    until(page, "document.querySelector('#fly-state').textContent.includes('gave the drone back')")
    assert broken == []


def test_errors_are_shown_and_the_server_may_come_back(visit, data):
    server = Server(data)
    page = visit("#replay?a=nobody", url=server.url, faultless=False)
    page.locator("#notices", has_text="Error of the server").wait_for()
    page.goto(server.url + "#live")
    until(page, "document.querySelector('#sessions').textContent.includes('No session is running')")
    server.stop()
    page.locator("#notices", has_text="does not answer").wait_for()
    server = Server(data, server.port)
    page.locator("#notices", has_text="does not answer").wait_for(state="detached")
    server.stop()


def test_two_hosts_are_a_bad_request(server):
    with socket.create_connection(("127.0.0.1", server.port)) as link:
        link.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: elsewhere\r\nConnection: close\r\n\r\n")
        answer = b"".join(iter(lambda: link.recv(4096), b""))
    assert answer.startswith(b"HTTP/1.1 400") and b"several headers Host" in answer
