"""Replays in a real browser: one run or two, by mouse and by keys."""

from pathlib import Path

import numpy as np
import pytest
from browsing import (
    APART_S,
    LEANING,
    blue,
    canvas,
    canvas_with,
    linked,
    loaded,
    orange,
    position,
    settled,
    time_s,
    until,
)

from common import wait


def test_replay_moves(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&t=0"))
    start, at_start, line = (
        canvas(page),
        position(settled(page)),
        page.locator(".now").first.evaluate("(e) => e.style.transform"),
    )
    page.get_by_role("button", name="Play", exact=True).click()
    until(page, "parseFloat(document.querySelector('#time').textContent) > 2")
    page.get_by_role("button", name="Pause").click()
    assert position(settled(page)) != at_start
    assert page.locator(".now").first.evaluate("(e) => e.style.transform") != line
    assert (np.abs(canvas(page) - start).max(axis=-1) > 24).sum() > 200
    # a link to this moment shows this moment, also where it is no round number of ticks
    for key in ["", "ArrowRight", ","]:
        if key:
            page.keyboard.press(key)
        other = loaded(visit(linked(page)))
        assert time_s(other) == time_s(page) and position(settled(other)) == position(settled(page))


def test_the_vehicle_leans_where_it_accelerates(visit, attempts):
    up_x, up_y, vx, vy, t = np.array(visit("#board").evaluate(LEANING, attempts[1])).T
    for name, up, v in [("x", up_x, vx), ("y", up_y, vy)]:
        # m/s^2 per radian of lean: gravity
        slope, correlation = np.polyfit(up, np.gradient(v, t), 1)[0], np.corrcoef(up, np.gradient(v, t))[0, 1]
        print(f"{name}: {slope:.2f} m/s^2 per unit of lean, correlation {correlation:.3f}")
        assert 8.5 < slope < 11 and correlation > 0.95


def test_it_begins_by_itself_with_the_best_run(visit, server):
    page = loaded(visit("#replay"))
    until(page, "Number(document.querySelector('#time').dataset.seconds) > 0.2")
    assert page.locator("#play").get_attribute("aria-label") == "Pause"
    assert page.locator(".picker.run-a option:checked").first.inner_text().startswith("thesis-pid")
    # a visitor who prefers less motion starts it by hand, and a link to a moment shows that moment
    for still in (visit("#replay", reduced_motion="reduce"), visit("#replay?t=0")):
        loaded(still).wait_for_timeout(300)
        assert time_s(still) == 0


# the browser's own clock, and the time that it shows, at two of its frames
SPEED = """async () => {
  const look = () => [performance.now() / 1000, Number(document.querySelector("#time").dataset.seconds)];
  const frame = () => new Promise((drawn) => requestAnimationFrame(drawn));
  await frame();
  const [from_s, shown_s] = look();
  while (look()[0] < from_s + 1) await frame();
  const [to_s, later_s] = look();
  return (later_s - shown_s) / (to_s - from_s);
}"""


def test_speed_is_what_it_says(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&t=0"))

    def is_right(speed):
        page.keyboard.press("Home")
        page.locator("#play").click()
        ratio = page.evaluate(SPEED)
        page.locator("#play").click()
        print(f"at x{speed}: {ratio:.2f} seconds of flight per second")
        return 0.6 * float(speed) < ratio < 1.25 * float(speed)

    for speed in ["0.5", "4"]:
        page.locator("#speed").select_option(speed)
        # a browser that stands still for a moment skips the time
        wait(lambda speed=speed: is_right(speed), f"x{speed} is another speed")


def test_keys(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&t=0"))
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
    # a clock that still runs shows it within 0.3 s
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
    t_s = visit("#board").evaluate(APART_S, attempts[:2])
    page = loaded(visit(f"#replay?a={attempts[0]}&b={attempts[1]}&t={t_s}"))
    assert page.locator("#legend .run-a, #legend .run-b").count() == 2
    assert page.locator("#readout th.run-b").is_visible()
    # one clock
    times = page.locator("#readout tr", has_text="time").locator("td").all_inner_texts()
    assert times == [f"{t_s} s"] * 2
    canvas_with(page, lambda view: blue(view) > 80 and orange(view) > 80)
    page.keyboard.press("v")

    def are_apart():
        apart = canvas(page)
        half = apart.shape[1] // 2
        left, right = apart[:, :half], apart[:, half:]
        counts = [blue(left), orange(left), blue(right), orange(right)]
        print(f"pixels of run A and B: left {counts[:2]}, right {counts[2:]}")
        return counts[0] > 80 and counts[1] < 20 and counts[2] < 20 and counts[3] > 80

    wait(are_apart)
    assert "view=split" in page.url


def test_two_runs_are_compared_in_numbers(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&b={attempts[1]}&t=4"))
    assert page.locator("#seeds").is_visible()
    told = {}
    for strip in page.locator(".strip").all():
        name, *numbers = strip.locator("figcaption span").all_inner_texts()
        told[name] = [float(number.replace("\u2212", "-")) for number in numbers[0].split(" | ")]
    a_cm, b_cm = told["off the set-point [cm]"]
    assert told["off the set-point, A \u2212 B [cm]"] == [pytest.approx(a_cm - b_cm, abs=0.11)]
    places = page.evaluate(
        """async (attempts) => {
          const { getReplay } = await import(location.origin + "/js/api.js");
          const flights = await Promise.all(attempts.map((attempt) => getReplay(attempt, 0)));
          return flights.map(([flight]) => ["x", "y", "z"].map((axis) => flight.get(axis, flight.rowAt(4))));
        }""",
        attempts[:2],
    )
    assert told["from A to B [cm]"] == [pytest.approx(100 * np.linalg.norm(np.subtract(*places)), abs=0.06)]
    # one run beside itself has one seed
    page.goto(page.url.split("#")[0] + f"#replay?a={attempts[0]}&b={attempts[0]}&t=4")
    until(page, "document.querySelector('#seeds').hidden")


def test_ticks_of_charts_are_whole(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&t=0"))
    # room for half of the last tick's number beside the chart, and for half of the highest one's above it
    room = page.evaluate("""() => [...document.querySelectorAll(".strip")].map((strip) => {
      const [canvas, over] = ["canvas", ".u-over"].map((part) => strip.querySelector(part).getBoundingClientRect());
      return [canvas.right - over.right, over.top - canvas.top];
    })""")
    assert min(right for right, _ in room) >= 12 and min(above for _, above in room) >= 7


def test_downloads(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&ea=3&t=0"))
    with page.expect_download() as log:
        page.get_by_role("link", name="Log of this flight").click()
    lines = Path(log.value.path()).read_text().splitlines()
    assert lines[0].startswith("t_s,") and len(lines) > 100
    with page.expect_download() as actions:
        page.get_by_role("link", name="All actions").click()
    assert len(Path(actions.value.path()).read_bytes()) % (4 * 4 * 20) == 0


def test_draws_only_when_something_changes(visit, attempts):
    page = loaded(visit(f"#replay?a={attempts[0]}&t=0"))
    page.evaluate("""() => {
      window.frames_drawn = 0;
      const { clear } = WebGL2RenderingContext.prototype;
      WebGL2RenderingContext.prototype.clear = function (...what) {
        window.frames_drawn += 1;
        return clear.apply(this, what);
      };
    }""")

    def is_idle():
        idle = page.evaluate("window.frames_drawn")
        page.wait_for_timeout(700)
        return page.evaluate("window.frames_drawn") == idle

    wait(is_idle, "it draws though nothing changes")
    idle = page.evaluate("window.frames_drawn")
    page.locator("#play").click()
    until(page, f"window.frames_drawn > {idle}")
