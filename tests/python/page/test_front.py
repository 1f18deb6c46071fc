"""The first minute: an idle server shows a flight, its address, how to take part, and how controllers compare."""

import json
import subprocess
import sys
import urllib.error
import urllib.request

import numpy as np
import pytest
from browsing import CRAZYFLIE, SCENARIO, Server, canvas, changed, close_to, drawn, moves, until

from common import LIMIT_S, wait

# pixels: a flight that is seen moving changes more
MOVED = 60


def submit(controller, scenario, data):
    command = [*CRAZYFLIE, "bench", "submit", "--controller", controller, "--scenario", scenario, "--data", str(data)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=LIMIT_S)


def stands_still(page):
    """Whether the 3D view is the same after a moment."""
    drawn(page)
    before = canvas(page)
    page.wait_for_timeout(900)
    return changed(before, canvas(page)) == 0


def get(server, path, **headers):
    """Status, headers and body."""
    try:
        with urllib.request.urlopen(urllib.request.Request(server.url + path, headers=headers)) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.headers, error.read()


def about(server):
    """Whose flight the showcase is."""
    _, _, frames = get(server, "api/v1/showcase")
    length = int.from_bytes(frames[:4], "little")
    return json.loads(frames[4 : 4 + length])["showcase"]


@pytest.fixture
def empty_server(tmp_path):
    """Nobody has ever flown here."""
    server = Server(str(tmp_path / "bench.sqlite"))
    yield server
    server.stop()


def test_an_idle_server_shows_the_best_attempt(visit, server):
    _, _, listed = get(server, "api/v1/attempts")
    best = max(json.loads(listed), key=lambda attempt: attempt["result"]["score"]["score"])
    page = visit("")
    until(page, f"document.querySelector('#showcase-title').textContent.includes('{best['controller']} of local')")
    assert page.locator("#empty").is_hidden() and page.locator("#charts").is_hidden()
    assert "simulator of the Crazyflie" in page.locator("#welcome").inner_text()
    assert "No session is running" in page.locator("#sessions").inner_text()
    moves(page, canvas(page), MOVED)
    # it can be stopped
    page.locator("#showcase-play").click()
    assert page.locator("#showcase-play").inner_text() == "Play"
    wait(lambda: stands_still(page), "it goes on")
    page.get_by_role("link", name="Replay", exact=True).first.click()
    until(page, "document.body.dataset.view === 'replay'")


def test_whoever_wants_less_motion_starts_it_by_hand(visit):
    page = visit("", reduced_motion="reduce")
    until(page, "document.querySelector('#showcase-title').textContent !== ''")
    wait(lambda: stands_still(page), "it moves by itself")
    before = canvas(page)
    page.locator("#showcase-play").click()
    moves(page, before, MOVED)


def test_without_attempts_eight_drones_change_places_again_and_again(empty_server, visit):
    page = visit("", url=empty_server.url)
    until(page, "document.querySelector('#showcase-title').textContent.includes('Eight')")
    moves(page, canvas(page), MOVED)
    # eight hues: from the blue of run A around the circle
    hues = [f"hsl({(210 + 45 * drone) % 360} 75% 42%)" for drone in range(8)]
    colours = page.evaluate(
        """(hues) => hues.map((hue) => {
          const probe = document.body.appendChild(document.createElement("i"));
          probe.style.color = hue;
          const found = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
          probe.remove();
          return found;
        })""",
        hues,
    )
    pixels = []

    def are_seen():
        picture = canvas(page)
        pixels[:] = [int(close_to(picture, np.array(colour), 30).sum()) for colour in colours]
        return min(pixels) > 20

    wait(are_seen, lambda: f"pixels of each drone's colour: {pixels}")
    seconds = "Number(document.querySelector('#showcase-bar').dataset.seconds)"
    until(page, f"{seconds} > 8")
    until(page, f"{seconds} < 4")
    page.goto(empty_server.url + "#board")
    until(page, "document.querySelector('#overview').textContent.includes('No attempt is over yet')")


def test_the_flight_is_made_once_and_again_for_a_better_attempt(empty_server, tmp_path):
    status, headers, frames = get(empty_server, "api/v1/showcase")
    assert status == 200 and about(empty_server) is None
    again = get(empty_server, "api/v1/showcase", **{"If-None-Match": headers["etag"]})
    assert again[0] == 304 and again[2] == b""
    cpu_s = empty_server.cpu_s()
    for _ in range(200):
        assert get(empty_server, "api/v1/showcase")[2] == frames
    used_s = empty_server.cpu_s() - cpu_s
    print(f"200 viewers: {used_s:.2f} s of the server's CPU")
    # flown for each of them it would be minutes
    assert used_s < 20.0
    for controller in ["stock-pid", "thesis-pid"]:
        submit(controller, SCENARIO, tmp_path / "bench.sqlite")
        wait(
            lambda controller=controller: (about(empty_server) or {}).get("controller") == controller,
            lambda controller=controller: f"{controller} is stored, shown is {about(empty_server)}",
        )
    # a worse one is never shown: the server has looked at its database again when it shows the one after it
    submit("stock-pid", SCENARIO, tmp_path / "bench.sqlite")
    submit("lqr", "takeoff", tmp_path / "bench.sqlite")
    shown = []

    def shows_the_last():
        shown.append(about(empty_server)["controller"])
        return shown[-1] == "lqr"

    wait(shows_the_last)
    assert set(shown) <= {"thesis-pid", "lqr"}


def test_the_address_is_the_servers_and_can_be_copied(visit, server):
    page = visit("", permissions=["clipboard-read", "clipboard-write"])
    address = server.url.replace("http", "ws") + "ws"
    page.get_by_role("button", name="Copy the address").click()
    page.get_by_text("Copied").wait_for()
    assert page.evaluate("navigator.clipboard.readText()") == address
    for way in ["way-python", "way-shell"]:
        assert address in page.locator(f"#{way}").inner_text()
    page.locator("[data-copies=way-any]").click()
    requests = [json.loads(line) for line in page.evaluate("navigator.clipboard.readText()").splitlines()]
    assert [request["type"] for request in requests] == ["make", "reset", "step"]
    # the text that is linked is the protocol's
    link = page.get_by_role("link", name="The protocol").get_attribute("href")
    answer = page.request.get(server.url + link)
    assert answer.ok and answer.text().startswith("# The protocol") and "text/plain" in answer.headers["content-type"]


def test_the_ways_to_take_part_work(visit, server):
    page = visit("")
    python = page.locator("#way-python").inner_text()
    subprocess.run([sys.executable, "-c", python], check=True, timeout=LIMIT_S)
    replies = page.evaluate(
        """async (texts) => {
          const socket = new WebSocket(document.querySelector("#address").textContent, "crazyflie.v1");
          await new Promise((open) => (socket.onopen = open));
          const replies = [];
          for (const text of texts) {
            const answered = new Promise((message) => (socket.onmessage = message));
            socket.send(text);
            replies.push(JSON.parse((await answered).data).type);
          }
          socket.close(1000);
          return replies;
        }""",
        page.locator("#way-any").inner_text().splitlines(),
    )
    assert replies == ["made", "observation", "result"]
    shell = page.locator("#way-shell").inner_text().replace("\\\n", " ").split()
    flags = subprocess.run([*CRAZYFLIE, "bench", "submit", "--help"], check=True, capture_output=True, text=True).stdout
    assert shell[:3] == ["crazyflie", "bench", "submit"]
    assert all(flag in flags for flag in shell if flag.startswith("--"))


def test_the_overview_is_what_the_leaderboards_say(visit, server, data):
    submit("lqr", "takeoff", data)
    wait(lambda: b"lqr" in get(server, "api/v1/overview")[2], "the server does not look at its database again")
    page = visit("#board")
    table = page.locator("#overview table")
    table.wait_for()
    heads = [head.split("\n")[0] for head in table.locator("thead th").all_inner_texts()]
    shown = {}
    for row in table.locator("tbody tr").all():
        who = row.locator("th strong").inner_text()
        for head, cell in zip(heads[1:], row.locator("td").all_inner_texts(), strict=True):
            shown[who, head] = cell
    scores = {}
    for head in heads[1:]:
        _, _, board = get(server, f"api/v1/leaderboard?scenario={head}")
        scores |= {(row["controller"], head): f"{row['score']:.1f}" for row in json.loads(board)}
    assert set(heads[1:]) == {SCENARIO, "takeoff"} and len(scores) == 3
    assert {key: cell for key, cell in shown.items() if cell != "\u2013"} == scores
    assert len({who for who, _ in shown}) == 3
    assert "Not flown yet: battery-low" in page.locator("#overview-rest").inner_text()
    table.get_by_role("link", name=scores["lqr", "takeoff"]).click()
    until(page, "document.body.dataset.view === 'replay'")


def test_the_score_is_explained(visit):
    words = visit("").locator("#score").inner_text()
    for word in ["median", "did not fail", "cost", "100"]:
        assert word in words
