"""Hooks of the site: pages from outside docs, files beside docs, formulas as MathML.

README.md, CHANGELOG.md, ARCHITECTURE.md, CONTRIBUTING.md and the list of examples are pages of the site as they stand. A link that leaves docs
leads to a copy of the file in the site: it works without a network, and a missing file is found. README.md links to
the repository's own address, since PyPI shows it alone; in the site these links are local too.
"""

import html
import inspect
import posixpath
import pydoc
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "examples/README.md": "examples.md",
}
# links of README.md to files of the repository: pages and pictures
REPOSITORY = re.compile(r"https://github\.com/crazyflie-gym/crazyflie-gym/(?:blob|raw)/main/")
_LINK = re.compile(r"(\]\()([^)\s#]+)")
_FORMULAS = [
    (re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL), "block"),
    (re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL), "inline"),
]
# pages in the order of the navigation
_IN_ORDER = []
_FENCE = re.compile(r"(^```.*?^```)", re.MULTILINE | re.DOTALL)


def on_files(files, config):
    """Add the pages from outside docs, and the files that pages link to outside docs."""
    for name, page in PAGES.items():
        here = posixpath.dirname(name)
        text = _rewritten(
            _text(ROOT / name),
            lambda target, here=here: _from_root(posixpath.normpath(posixpath.join(here, target))),
        )
        files.append(File.generated(config, page, content=text))
    for path in sorted({*ROOT.glob("examples/**/*.*"), *_linked()}):
        if "__pycache__" not in path.parts:
            name = f"files/{path.relative_to(ROOT)}"
            # a browser shows text where it would run or download a program
            files.append(File.generated(config, name + _ending(path), content=path.read_bytes()))
    return files


def on_nav(nav, config, files):
    """Keep the order of the pages for their list."""
    _IN_ORDER[:] = nav.pages


def on_page_markdown(markdown, page, config, files):
    """Let links that leave docs lead to the copies."""
    if page.file.src_uri in PAGES.values():
        return markdown
    here = posixpath.dirname(page.file.src_uri)

    def target_of(target):
        path = posixpath.normpath(posixpath.join(here, target))
        if path.startswith("../"):
            found = _from_root(path[3:])
        elif path.endswith(".py"):
            found = f"files/docs/{path}.txt"
        else:
            return target
        return posixpath.relpath(found, here or ".")

    return _rewritten(markdown, target_of)


def on_post_build(config):
    """Write every page as Markdown beside its HTML, and their list for language models (https://llmstxt.org)."""
    site = Path(config.site_dir)
    lines = [f"# {config.site_name}", "", f"> {config.site_description}"]
    section = None
    for page in _IN_ORDER:
        (site / page.file.src_uri).write_text(_with_docstrings(page.markdown))
        if page.ancestors[-1] is not section:
            section = page.ancestors[-1]
            lines += ["", f"## {section.title}", ""]
        lines.append(f"- [{page.title}]({page.file.src_uri})")
    (site / "llms.txt").write_text("\n".join(lines) + "\n")


def _with_docstrings(markdown):
    """Return the text with signatures and docstrings of each object and its methods in place of its mark."""

    def described(name, it):
        signature = inspect.signature(it) if inspect.isroutine(it) else ""
        return f"### `{name}{signature}`\n\n{inspect.getdoc(it)}\n"

    def expanded(found):
        it = pydoc.locate(found[1])
        methods = [(n, m) for n, m in vars(it).items() if inspect.isfunction(m) and n[0] != "_" and m.__doc__]
        return "\n".join(described(*each) for each in [(found[1], it), *(methods if inspect.isclass(it) else [])])

    return re.sub(r"^::: (\S+)$", expanded, markdown, flags=re.MULTILINE)


def on_page_content(content, page, config, files):
    """Write formulas as MathML, which browsers draw by themselves."""
    for pattern, display in _FORMULAS:
        content = pattern.sub(lambda found, display=display: _math(found[1], display), content)
    return content


def _math(text, display):
    return convert(html.unescape(text.strip()), display=display)


def _text(page):
    return REPOSITORY.sub("", page.read_text())


def _rewritten(markdown, target_of):
    """Return the text with its local links rewritten, code blocks left as they are."""

    def link(found):
        target = found[2]
        return found[0] if "://" in target or target.startswith("mailto:") else found[1] + target_of(target)

    parts = _FENCE.split(markdown)
    return "".join(part if part.startswith("```") else _LINK.sub(link, part) for part in parts)


def _from_root(target):
    """Return where the site has what the root has under a path."""
    if target in PAGES:
        return PAGES[target]
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    path = ROOT / target
    return f"files/{target}{_ending(path)}" if path.is_file() else target


def _ending(path):
    return ".txt" if path.suffix in {".py", ".toml", ".rs", ".md"} or not path.suffix else ""


def _linked():
    """Return the files outside docs and examples that a page links to."""
    pages = [*(ROOT / name for name in PAGES), *ROOT.glob("docs/**/*.md")]
    for page in pages:
        for _, target in _LINK.findall(_FENCE.sub("", _text(page))):
            path = (page.parent / target).resolve()
            beside = ROOT / "docs" not in path.parents or path.suffix == ".py"
            if ROOT in path.parents and beside and path.is_file() and path.relative_to(ROOT).as_posix() not in PAGES:
                yield path
