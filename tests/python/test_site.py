"""The documentation site: it builds without a warning and without the network, and its pages are those of the code."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import crazyflie_gym
from common import LIMIT_S

pytest.importorskip("mkdocs")

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs/tools"))

import formulas  # noqa: E402
import frames  # noqa: E402
import generate  # noqa: E402
import hooks  # noqa: E402


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    # nothing answers at this proxy: what would be fetched fails
    env = os.environ | {
        "NO_MKDOCS_2_WARNING": "1",
        "https_proxy": "http://127.0.0.1:9",
        "http_proxy": "http://127.0.0.1:9",
    }
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder],
        cwd=ROOT, env=env, capture_output=True, text=True, check=False, timeout=LIMIT_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_every_page_is_in_the_navigation_and_loads_nothing_from_elsewhere(site):
    pages = sorted(site.glob("**/*.html"))
    # those of docs, of the root, and "not found"
    assert len(pages) > 30
    loaded = re.compile(
        r'<(?:script|img|iframe)[^>]*\ssrc="(https?:)?//|<link[^>]*rel="(?:stylesheet|preconnect)"[^>]*href="(https?:)?//'
    )
    for page in pages:
        found = loaded.search(page.read_text())
        assert found is None, f"{page.name}: {found and found[0]}"
    for sheet in site.glob("**/*.css"):
        assert "url(http" not in sheet.read_text(), sheet.name


def test_every_page_is_there_as_markdown_and_in_the_list_for_language_models(site):
    listed = re.findall(r"^- \[.+\]\((.+\.md)\)$", (site / "llms.txt").read_text(), re.MULTILINE)
    pages = {page.relative_to(site).with_suffix(".md").as_posix() for page in site.glob("**/*.html")} - {"404.md"}
    assert set(listed) == pages and len(listed) == len(pages)
    assert all((site / page).read_text().strip() for page in listed)
    reference = (site / "reference/python.md").read_text()
    assert ":::" not in reference and "### `step" in reference and len(reference) > 20_000


def test_formulas_are_drawn_and_not_told(site):
    model = (site / "concepts/model.html").read_text()
    assert model.count("<math") >= 11 + sum(map(len, formulas.GROUPS.values())) and "arithmatex" not in model
    assert "123.2" in model and "1208.592" in model


def test_the_python_reference_has_every_public_name(site):
    page = (site / "reference/python.html").read_text()
    for name in (
        "CrazyflieEnv",
        "CrazyflieVectorEnv",
        "CrazyflieSwarm",
        "make_task",
        "WindField",
        "model_from_datasheet",
    ):
        assert f'id="crazyflie_gym.{name}"' in page, name
    assert 'id="crazyflie_gym.evaluation.fly"' in page and 'id="crazyflie_gym.CrazyflieEnv.step"' in page


@pytest.mark.parametrize("page", sorted(generate.PAGES))
def test_generated_pages_are_those_of_the_code(page):
    assert (ROOT / "docs" / page).read_text() == generate.PAGES[page](), f"docs/{page} is stale: make docs"


def test_links_of_the_readme_work_on_pypi_and_lead_to_files():
    text = (ROOT / "README.md").read_text()
    links = re.findall(r"(!?)\[[^\]]*\]\(([^)\s]+)\)", text)
    assert [target for _, target in links if "://" not in target] == []
    repository = f'Repository = "{hooks.REPOSITORY.pattern.split("/(?:")[0]}"'.replace("\\", "")
    assert repository in (ROOT / "pyproject.toml").read_text()
    own = [(mark, target) for mark, target in links if hooks.REPOSITORY.match(target)]
    assert len(own) > 25
    for mark, target in own:
        assert (ROOT / hooks.REPOSITORY.sub("", target).partition("#")[0]).is_file(), target
        assert ("/raw/" in target) == bool(mark), f"{target}: a picture is raw, a page is not"


def test_every_effect_has_a_formula():
    named = [name for group in formulas.GROUPS.values() for name in group]
    assert sorted(named) == sorted(effect["name"] for effect in crazyflie_gym.effects())


def test_the_drawing_of_frames_is_what_its_script_draws():
    assert (ROOT / "docs/pictures/frames.svg").read_text() == frames.draw_frames(), "make pictures"


def test_every_picture_has_a_script_and_a_page():
    script = (ROOT / "docs/tools/pictures.py").read_text()
    pages = "".join(path.read_text() for path in [ROOT / "README.md", *ROOT.glob("docs/**/*.md")])
    for path in (ROOT / "docs/pictures").glob("*.*"):
        assert f'"{path.name}"' in script and f"pictures/{path.name}" in pages, path.name


def test_every_example_that_draws_a_picture_shows_it():
    shown = set()
    for path in (ROOT / "examples").glob("*.py"):
        pictures = generate.pictures_of(path)
        assert len(pictures) == (generate.picture_of(path) is not None), f"{path.name}: make pictures"
        shown |= set(pictures)
    assert shown == {f"examples/{path.name}" for path in (ROOT / "docs/pictures/examples").iterdir()}


def test_the_citation_has_the_version_of_the_package():
    assert f"version: {crazyflie_gym.__version__}\n" in (ROOT / "CITATION.cff").read_text()
