"""A server with two attempts, a browser, and pages in it that must be without fault."""

import subprocess

import pytest
from browsing import CHROMIUM, CRAZYFLIE, FLAGS, PATIENCE_MS, SCENARIO, Server

from common import LIMIT_S


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = str(tmp_path_factory.mktemp("page") / "bench.sqlite")
    for controller in ["thesis-pid", "stock-pid"]:
        command = [*CRAZYFLIE, "bench", "submit", "--controller", controller, "--scenario", SCENARIO, "--data", path]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=LIMIT_S)
    return path


@pytest.fixture(scope="module")
def server(data):
    server = Server(data)
    yield server
    server.stop()


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api", reason="the page is not tested: pip install playwright")
    if CHROMIUM is None:
        pytest.skip("the page is not tested: no chromium here (apt-get install chromium)")
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
