"""The tuner of the page: its sliders fly the simulator, and what it shows is what the server answers."""

import pytest
from browsing import until

DRAWN = "document.querySelectorAll('#tuner-plots .strip canvas').length === 4"


def figure(page, name):
    return page.locator("#tuner-figures div", has_text=name).locator("dd").inner_text()


def slide(page, gain, to):
    """Drag a slider: the browser tells of each step on the way, as of a hand's."""
    page.evaluate(
        """([gain, to]) => {
          const slider = document.querySelector(`#tuner-${gain}`);
          for (let part = 1; part <= 5; part += 1) {
            slider.value = (to * part) / 5;
            slider.dispatchEvent(new Event("input", { bubbles: true }));
          }
        }""",
        [gain, to],
    )


def test_sliders_fly_what_they_say(visit):
    page = visit("#tuner")
    until(page, DRAWN)
    assert figure(page, "on paper") == "stable" and figure(page, "crashed") == "0 of 1000"
    # a margin below 30 degrees is no good one
    assert figure(page, "phase margin") == "19\u00b0, little"
    assert page.locator("#tuner-figures div", has_text="phase margin").locator("dd").get_attribute("class") == "warn"
    before = page.locator("[data-plot=flights] canvas").screenshot()
    slide(page, "kp", 0.8)
    until(page, "document.querySelector('#tuner-figures').innerText.includes('unstable')")
    assert float(page.locator("#tuner-kp-value").inner_text()) > 60_000
    until(page, "location.hash.includes('kp=')")
    assert page.locator("[data-plot=flights] canvas").screenshot() != before
    page.get_by_role("button", name="Table 7.1").click()
    until(page, "!document.querySelector('#tuner-figures').innerText.includes('unstable')")
    assert "kp=" not in page.url


def test_a_link_shows_the_same_gains(visit):
    page = visit("#tuner?loop=x&vehicle=cf2-thesis-drag&vertical=thrust&sensors=ideal&kp=20")
    until(page, DRAWN)
    assert page.locator("#tuner-kp-value").inner_text() == "20"
    assert page.locator("#tuner-loop").input_value() == "x"
    assert page.locator("#tuner-sensors").input_value() == "ideal"
    # the height form has no height loop, so that choice is none
    page.locator("#tuner-form").select_option("height")
    page.locator("#tuner-loop").select_option("z")
    until(page, "document.querySelector('#tuner-form').value === 'thrust'")


def test_bad_questions_are_refused_in_words(server, visit):
    page = visit("#board")
    for query, words in [
        ("loop=zz", "did you mean"),
        ("loop=z&vertical=height", "pwm or thrust"),
        ("loop=x&kp=NaN", "kp"),
        ("loop=x&flights=100000", "1000"),
        ("", "loop"),
        ("loop=x&speed=3", "speed"),
    ]:
        answer = page.request.get(f"{server.url}api/v1/tuner?{query}")
        assert answer.status == 400 and words in answer.json()["message"], (query, answer.text())


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_on_a_phone(visit, scheme):
    page = visit("#tuner", viewport={"width": 360, "height": 740}, color_scheme=scheme)
    until(page, DRAWN)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_only_forms_that_the_vehicle_has_can_be_chosen(visit):
    page = visit("#tuner?loop=x&vehicle=cf2-thesis&vertical=pwm&sensors=ideal")
    page.wait_for_selector("#tuner-vehicle option[value=cf21-brushless]", state="attached")
    page.select_option("#tuner-vehicle", "cf21-brushless")
    disabled = page.eval_on_selector_all("#tuner-form option:disabled", "all => all.map((option) => option.value)")
    assert sorted(disabled) == ["height", "pwm"] and page.input_value("#tuner-form") == "thrust"
