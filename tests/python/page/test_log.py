"""A flight log dropped on the page: it flies beside its model, with the residual, or is refused in words."""

import base64
import subprocess

import pytest
from browsing import CRAZYFLIE, blue, canvas_with, drawn, obstacles, orange, settled, time_s, until

from common import LIMIT_S, wait

TOLD = "document.querySelector('#log-fits') && document.querySelector('#empty').hidden"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A flight of the simulator, as the recorder beside a real one writes it."""
    path = tmp_path_factory.mktemp("log") / "flight.csv"
    command = [*CRAZYFLIE, "fly", "--task", "fly-80cm", "--sensors", "lab", "--csv", str(path)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=LIMIT_S)
    return path


def turned(log, tmp_path):
    """The same flight with the sign of its pitch turned."""
    names, *rows = [line.split(",") for line in log.read_text().splitlines()]
    at = names.index("imu_pitch_deg")
    for row in rows:
        row[at] = str(-float(row[at]))
    path = tmp_path / "turned.csv"
    path.write_text("\n".join(",".join(row) for row in [names, *rows]) + "\n")
    return path


def drop(page, path):
    """Drags a file over the page and lets it fall."""
    page.evaluate(
        """([name, text]) => {
          const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
          const dataTransfer = new DataTransfer();
          dataTransfer.items.add(new File([bytes], name));
          for (const type of ["dragover", "drop"])
            document.body.dispatchEvent(new DragEvent(type, { dataTransfer, bubbles: true, cancelable: true }));
        }""",
        [path.name, base64.b64encode(path.read_bytes()).decode()],
    )


def errors(page):
    """RMSE by signal."""
    rows = [row.split("\t") for row in page.locator("#log-fits tbody").inner_text().splitlines()]
    return {name: float(rmse.split()[0]) for name, _, rmse, _ in rows}


def readings(page):
    """The values of the moment in each chart."""
    strips = [strip.locator("figcaption span").all_inner_texts() for strip in page.locator(".strip").all()]
    return {name: [float(part.replace("\u2212", "-")) for part in told.split(" | ")] for name, told in strips}


def test_a_dropped_log_flies_beside_its_model(visit, log):
    page = visit("#tuner", reduced_motion="reduce")
    drop(page, log)
    until(page, TOLD)
    assert page.url.endswith("#log") and "a project CSV on cf2-thesis" in page.locator("#log-fits").inner_text()
    assert page.locator(".strip").count() == 16
    page.locator("#scrub").evaluate("(e) => { e.value = 4; e.dispatchEvent(new Event('input')); }")
    assert time_s(settled(page)) == 4
    told = readings(page)
    for name in ["x [m]", "y [m]", "z [m]", "roll [\u00b0]"]:
        residual = told[name.replace(" [", ", measured \u2212 model [")]
        assert residual == [pytest.approx(told[name][0] - told[name][1], abs=0.11 if "\u00b0" in name else 0.011)]
    # both fly the same way: each is seen in a view of its own
    page.keyboard.press("v")
    canvas_with(page, lambda view: blue(view) > 80 and orange(view) > 80)
    assert page.locator("#readout th.run-a").inner_text() == "measured"
    # every two seconds the model starts from the measurement; a free run goes astray
    every = errors(page)
    page.locator("#log-horizon").select_option("")
    wait(lambda: page.locator("#log-fits").count() and errors(page) != every, "the free run has the same errors")
    free = errors(page)
    assert free["x"] > every["x"]
    page.locator("#log-vehicle").select_option("cf2-thesis-drag")
    wait(lambda: page.locator("#log-fits").count() and errors(page) != free, "another vehicle has the same errors")
    assert "on cf2-thesis-drag" in page.locator("#log-fits").inner_text()


def test_it_plays_and_another_view_leaves_it(visit, log):
    page = visit("#log")
    page.locator("#log-file").set_input_files(log)
    until(page, TOLD)
    until(page, "Number(document.querySelector('#time').dataset.seconds) > 0.2")
    page.keyboard.press("Space")
    assert page.locator("#play").get_attribute("aria-label") == "Play"
    page.keyboard.press("v")
    until(page, "document.querySelector('#stage').classList.contains('split')")
    page.get_by_role("link", name="Replay", exact=True).click()
    until(page, "document.querySelectorAll('.strip').length >= 9 && !document.querySelector('#log-told').offsetParent")
    page.locator("#play").click()
    page.get_by_role("link", name="Log", exact=True).click()
    until(page, "document.querySelectorAll('.strip').length === 16")


def test_a_grave_finding_is_shown_with_its_cure(visit, log, tmp_path):
    # the browser logs that the server refuses it
    page = visit("#log", faultless=False)
    until(page, "document.querySelector('#log-vehicle').options.length > 0")
    drop(page, turned(log, tmp_path))
    until(page, "document.querySelector('#log-told').innerText.includes('[scale] pitch = -1')")
    assert "This log is refused" in page.locator("#empty").inner_text() and page.locator(".strip").count() == 0
    page.get_by_role("button", name="Replay it all the same").click()
    until(page, TOLD)
    assert "grave: pitch contradicts the motion" in page.locator("#log-told").inner_text()


def test_what_is_no_log_is_said(visit, tmp_path):
    page = visit("#log", faultless=False)
    for name, content, words in [
        ("letter.txt", b"To whom it may concern\n", "letter.txt"),
        ("large.csv", b"1" * ((16 << 20) + 1), "at most 16 MiB"),
    ]:
        path = tmp_path / name
        path.write_bytes(content)
        page.locator("#log-file").set_input_files(path)
        until(page, f"document.querySelector('#notices').innerText.includes({words!r})")
        assert "Drop a flight log" in page.locator("#empty").inner_text()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_on_a_phone(visit, log, scheme):
    page = visit("#log", viewport={"width": 360, "height": 740}, color_scheme=scheme, reduced_motion="reduce")
    page.locator("#log-file").set_input_files(log)
    until(page, TOLD)
    drawn(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.locator("#log-told summary").click()
    assert obstacles(page) == []
    page.set_viewport_size({"width": 1000, "height": 660})
    assert obstacles(page) == []
