"""A drone flown by hand in the browser, beside the thesis's PID: what moves it, switches, and the list of flights."""

import json
import re
import urllib.request

import pytest
from browsing import Server, canvas, canvas_with, close_to, moves, until

from common import wait

# x, y, z of the drone by hand, as the server has them now
PLACE = """async () => {
  const worlds = await (await fetch("api/v1/worlds")).json();
  const world = worlds.filter(({ over }) => !over).sort((a, b) => a.since_s - b.since_s)[0];
  const socket = new WebSocket(location.origin.replace("http", "ws") + "/live", "crazyflie.live.v1");
  socket.binaryType = "arraybuffer";
  await new Promise((open) => (socket.onopen = open));
  let header = null;
  const row = await new Promise((found) => {
    socket.onmessage = ({ data }) => {
      if (header) found(new Float32Array(data));
      header ??= data;
    };
    socket.send(JSON.stringify({ watch: world.session }));
  });
  socket.close();
  const own = row.length / 2;
  return [1, 2, 3].map((column) => row[own + column]);
}"""
# a browser's gamepad: four axes, right stick forward
GAMEPAD = """(axes) => {
  navigator.getGamepads = () => [{ id: "test pad", connected: true, axes, buttons: [] }];
  window.dispatchEvent(new Event("gamepadconnected"));
}"""


# colours of the PID's drone and of the one by hand
HUES = [[27, 107, 187], [187, 107, 27]]


def parts(picture):
    """Pixels of each drone's colour: the drone and its ring."""
    return [int(close_to(picture, hue, 30).sum()) for hue in HUES]


def get(server, path):
    with urllib.request.urlopen(server.url + path) as answer:
        return answer.read().decode()


def newest_world(server):
    return min(json.loads(get(server, "api/v1/worlds")), key=lambda world: world["since_s"])


def log(server):
    """Plan and ticks of the world that was founded last."""
    head, *ticks, _ = get(server, f"api/v1/worlds/{newest_world(server)['world']}/log").splitlines()
    return json.loads(head), [json.loads(tick) for tick in ticks]


def take_off(page, task="formation"):
    page.locator("#fly-task").select_option(task)
    page.get_by_role("button", name="Take off").click()
    until(page, "document.querySelector('#fly-state').textContent.includes('You fly')")
    until(page, "document.querySelector('#empty').hidden")
    return page


def moved(page, start, axis, by_m):
    """Where the drone is when it has moved so far along an axis; a busy machine takes longer."""
    places = [start]

    def has_moved():
        places.append(page.evaluate(PLACE))
        return (places[-1][axis] - start[axis]) * (1 if by_m > 0 else -1) > abs(by_m)

    wait(has_moved, lambda: f"from {start} it came to {places[-1]}")
    return places[-1]


def state(page, words):
    until(page, f"document.querySelector('#fly-state').textContent.includes('{words}')")


def rows(page):
    return page.locator("#flown tbody tr").all_inner_texts()


def test_keys_move_the_drone_and_the_flight_is_listed(visit, server):
    page = take_off(visit("#fly"))
    before = canvas(page)
    start = page.evaluate(PLACE)
    page.wait_for_timeout(800)
    held = page.evaluate(PLACE)
    page.keyboard.down("w")
    ahead = moved(page, held, 0, 0.25)
    page.keyboard.up("w")
    page.keyboard.down("r")
    risen = moved(page, ahead, 2, 0.08)
    page.keyboard.up("r")
    print(f"at the start {start}, without keys {held}, after w {ahead}, after r {risen}")
    assert abs(held[0] - start[0]) < 0.1 and abs(held[2] - start[2]) < 0.1
    assert abs(ahead[1] - held[1]) < 0.2 and abs(ahead[2] - held[2]) < 0.1
    moves(page, before)
    assert "PID" in page.locator("#fly-numbers").inner_text() and "you" in page.locator("#legend").inner_text()
    page.keyboard.press("Escape")
    state(page, "gave the drone back")
    until(page, "document.querySelector('#flown tbody') !== null")
    until(page, "document.querySelector('#flown tbody tr').textContent.includes('by you')")
    # the list has the server's figures, and survives a reload
    flown = json.loads(get(server, "api/v1/flown"))[0]
    _, ticks = log(server)
    by_hand = [tick for tick in ticks if tick["by"][1] in ("pilot", "late")]
    assert flown["duration_s"] == pytest.approx(0.02 * len(by_hand)) and flown["end"] is None
    listed = rows(page)
    assert f"{100 * flown['rms_m']:.1f}" in listed[0] and "gave the drone back" in listed[0]
    assert flown["autopilot_rms_m"] < flown["rms_m"] and f"{100 * flown['autopilot_rms_m']:.1f}" in listed[0]
    page.reload()
    until(page, "document.querySelector('#flown tbody') !== null")
    assert rows(page) == listed
    # a pilot who gives the drone back no longer flies it
    world = newest_world(server)
    assert world["by"] == ["autopilot", "autopilot"]


@pytest.mark.parametrize("switches", [[], ["camera"], ["delay"], ["camera", "delay"]])
def test_switches_change_the_worlds_plan(visit, server, switches):
    page = visit("#fly")
    for switch in switches:
        page.locator(f"#fly-{switch}").check()
    take_off(page)
    wait(lambda: any(tick["by"][1] == "pilot" for tick in log(server)[1]))
    page.keyboard.press("Escape")
    state(page, "gave the drone back")
    head, ticks = log(server)
    effects = head["options"]["effects"]
    print(effects)
    assert ("camera" in effects and effects["camera_latency"] == {"latency_s": 0.05}) == ("camera" in switches)
    assert ("cmd_delay" in effects) == ("delay" in switches)
    assert (head["mission"], head["drones"], head["autopilot"]) == ("formation", 2, "thesis-pid")
    assert ticks[-1]["by"][0] == "autopilot" and any(tick["by"][1] == "pilot" for tick in ticks)
    until(page, f"document.querySelector('#flown tbody tr').innerText.includes('{', '.join(switches) or 'nothing'}')")


def test_buttons_and_a_gamepad_fly_too(visit, server):
    page = take_off(visit("#fly"), "swap")
    start = page.evaluate(PLACE)
    button = page.get_by_role("button", name="Left", exact=True)
    button.hover()
    page.mouse.down()
    aside = moved(page, start, 1, 0.15)
    page.mouse.up()
    page.evaluate(GAMEPAD, [0, 0, 0, 1])
    assert "test pad" in page.locator("#fly-pad").inner_text()
    back = moved(page, aside, 0, -0.2)
    page.evaluate(GAMEPAD, [0.05, -0.05, 0, 0])
    print(f"at the start {start}, after the button {aside}, after the gamepad {back}")
    page.get_by_role("button", name="Stop").click()
    state(page, "gave the drone back")
    assert log(server)[0]["mission"] == "swap"


def test_before_take_off_all_is_in_view(visit):
    page = visit("#fly")
    until(page, "document.querySelector('#flown').textContent !== ''")
    seen = canvas_with(page, lambda view: min(parts(view)) > 10)
    page.locator("#fly-task").select_option("swap")
    moves(page, seen)


# from the middle of a thumb's pad, as a share of its reach
PUSH = """([pad, x, y]) => {
  const { left, top, width, height } = pad.getBoundingClientRect();
  const at = { clientX: left + (width * (1 + x)) / 2, clientY: top + (height * (1 + y)) / 2 };
  const tell = (type) => pad.dispatchEvent(new PointerEvent(type, { pointerId: 7, bubbles: true, ...at }));
  pad.setPointerCapture = () => {};
  pad.hasPointerCapture = () => true;
  tell(x || y ? "pointerdown" : "pointerup");
}"""


def test_thumbs_fly_on_a_phone(visit):
    page = visit("#fly", viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    start = page.locator("#fly-start")
    box = start.bounding_box()
    assert box["y"] + box["height"] < 844 and page.locator("kbd:visible").count() == 0
    assert "key" not in page.locator("#flight").inner_text().lower() and page.locator("#sticks").is_hidden()
    for pad in page.locator("#thumbs div").all():
        below = pad.bounding_box()
        assert below["y"] + below["height"] < 844
    take_off(page)
    held = page.evaluate(PLACE)
    pads = page.locator("#thumbs div").element_handles()
    page.evaluate(PUSH, [pads[1], 0, -0.8])
    ahead = moved(page, held, 0, 0.15)
    page.evaluate(PUSH, [pads[1], 0, 0])
    page.evaluate(PUSH, [pads[0], 0, -1])
    moved(page, ahead, 2, 0.05)
    page.get_by_role("button", name="Stop").click()
    state(page, "gave the drone back")


def test_the_autopilot_knows_of_nobody_and_the_camera_is_near(visit, server):
    page = take_off(visit("#fly"))
    until(page, "document.querySelector('#toggle-follow').getAttribute('aria-pressed') === 'true'")
    # the drone by hand, its ring and the arrow to it are much larger than where all of the room is seen
    wait(lambda: parts(canvas(page))[1] > 150)
    near = parts(canvas(page))[1]
    page.get_by_role("button", name="Whole").click()
    far = parts(canvas(page))[1]
    print(f"pixels of orange: {near} near by, {far} from far away")
    assert far < 0.6 * near
    page.keyboard.press("Escape")
    state(page, "gave the drone back")
    assert log(server)[0]["options"]["neighbours"] == {"by": "range", "range_m": 0}


def test_a_flight_that_ends_in_the_wall_is_listed_as_such(visit, server):
    page = take_off(visit("#fly"))
    page.keyboard.down("a")
    state(page, "You left the room. In")
    page.keyboard.up("a")
    until(page, "document.querySelector('#flown tbody tr').textContent.includes('left the room')")
    assert json.loads(get(server, "api/v1/flown"))[0]["end"] == "left_room"
    # a key that is still held for the drone means nothing else now
    follows = page.locator("#toggle-follow").get_attribute("aria-pressed")
    page.keyboard.press("f")
    assert page.locator("#toggle-follow").get_attribute("aria-pressed") == follows
    # the next flight begins from where the focus is
    assert page.evaluate("document.activeElement.id") == "fly-start"
    page.keyboard.press("Enter")
    state(page, "You fly")
    page.keyboard.press("Escape")
    state(page, "gave the drone back")


def test_a_hidden_page_gives_the_drone_back(visit, server):
    page = take_off(visit("#fly"))
    page.evaluate("""() => {
      Object.defineProperty(document, "hidden", { get: () => true, configurable: true });
      document.dispatchEvent(new Event("visibilitychange"));
    }""")
    state(page, "You left the page")
    wait(lambda: newest_world(server)["by"] == ["autopilot", "autopilot"])
    # so does another view
    page.evaluate("delete document.hidden")
    take_off(page)
    page.get_by_role("link", name="Leaderboard").click()
    wait(lambda: newest_world(server)["by"] == ["autopilot", "autopilot"])


def test_a_browser_that_hangs_does_not_stop_the_world(visit, server):
    page = visit("#fly")

    def ticks_while_it_hangs():
        take_off(page)
        before = newest_world(server)["ticks"]
        page.evaluate("() => { const end = performance.now() + 1500; while (performance.now() < end); }")
        ticks = newest_world(server)["ticks"] - before
        page.keyboard.press("Escape")
        state(page, "gave the drone back")
        return ticks

    # without a deadline it would be one or two; a busy server may stand still for as long
    wait(lambda: ticks_while_it_hangs() > 8)


def test_keys_are_the_controls_own_where_they_mean_something(visit):
    page = visit("#fly")
    # before take-off f follows the vehicle, as everywhere; in flight it lowers the drone
    page.locator("#stage canvas").press("f")
    assert page.locator("#toggle-follow").get_attribute("aria-pressed") == "true"
    take_off(page)
    page.keyboard.press("f")
    assert page.locator("#toggle-follow").get_attribute("aria-pressed") == "true"
    # all controls can be reached by keys, and tab is never taken
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement !== document.querySelector('#stage canvas')")
    page.keyboard.press("Escape")
    state(page, "gave the drone back")


def test_what_the_server_refuses_is_said_in_words(visit, data):
    server = Server(data)
    page = visit("#fly", url=server.url, faultless=False)
    until(page, "document.querySelector('#flown').textContent.includes('Nobody has flown')")
    page.evaluate("""async () => {
      const socket = new WebSocket(location.origin.replace("http", "ws") + "/ws", "crazyflie.v1");
      await new Promise((open) => (socket.onopen = open));
      const world = { type: "world", mission: "swap" };
      for (let id = 0; id < 64; id += 1) socket.send(JSON.stringify({ ...world, id, name: `full-${id}` }));
      await new Promise((full) => (socket.onmessage = ({ data }) => JSON.parse(data).type === "error" && full()));
    }""")
    page.get_by_role("button", name="Take off").click()
    page.locator("#notices", has_text="Error of the server").wait_for()
    assert page.locator("#fly-state").inner_text() == "The flight did not go on."
    assert page.locator("#fly-start").is_enabled()
    server.stop()
    page.get_by_role("button", name="Take off").click()
    page.locator("#notices", has_text=re.compile("does not (accept|answer)")).wait_for()
