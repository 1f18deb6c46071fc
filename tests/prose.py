"""Lists sentences whose subject is a relative clause, and counts seven overused verbs, over all texts.

python3 tests/prose.py [--list] [FOLDER]

Each kind of text has two limits: such sentences, and those verbs in a thousand words. No text has one of these
sentences; the limits of verbs are the numbers of the day on which they were set, and go down only.
"""

import ast
import inspect
import re
import sys
from pathlib import Path

# limits: sentences, verbs in a thousand words
LIMITS = {
    "pages": (0, 1.0),
    "generated pages": (0, 12.0),
    "changelog": (0, 2.0),
    "docstrings": (0, 3.5),
    "comments": (0, 1.0),
    "plain comments": (0, 9.1),
    "errors": (0, 3.2),
    "page": (0, 4.0),
}
# written by programs, from the texts of the code
GENERATED = {
    "docs/actions.md",
    "docs/cflib.md",
    "docs/effects.md",
    "docs/firmware.md",
    "docs/rates.md",
    "docs/tasks.md",
}
# marks of comments, and folders without own texts
MARKS = {".rs": "//", ".js": r"//|/\*\*|\*", ".py": "#", ".sh": "#", ".toml": "#", ".yml": "#"}
OTHERS = {"target", "out", ".venv", ".git", "notebooks"}
RELATIVE = re.compile(r"(?:What|Who|Whoever|Whatever|Whichever|Whose|How|Where|Whether|Of|As)\b(?!:|.*\?$)", re.DOTALL)
VERBS = re.compile(
    r"\b(?:tell(?:s|ing)?|told|say(?:s|ing)?|said|hold(?:s|ing)?|held|stand(?:s|ing)?|stood|com(?:e|es|ing)|came"
    r"|bear(?:s|ing)?|bore|borne|ask(?:s|ed|ing)?)\b",
    re.IGNORECASE,
)
RUST_ERROR = re.compile(r'(?:\w*[eE]rr\w*|bail!|anyhow!|context)\((?:&?format!\()?\s*"((?:[^"\\]|\\.)*)"')
END = re.compile(r"(?<=[.!?])[*\")]*\s+(?=[A-Z`\"*\[(])")
FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)


def paragraphs_of_page(text):
    """Return the paragraphs and list items of Markdown; no code, headings or tables."""
    text = re.sub(r"\A---\n.*?\n---\n|<!--.*?-->|!\[.*?\]\(.*?\)", "", FENCE.sub("\n", text), flags=re.DOTALL)
    lines = ["" if re.match(r"\s*(?:#|\||\$\$|!!!|</?\w)", line) else line for line in text.splitlines()]
    text = re.sub(r"^\s*(?:[-*>]|\d+\.) ", "\n", "\n".join(lines), flags=re.MULTILINE)
    return re.split(r"\n\s*\n", re.sub(r"\]\([^)]*\)", "]", text).replace("[", "").replace("]", ""))


def docstrings(text):
    """Return the paragraphs of all docstrings of Python, those of attributes too."""
    values = [node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Expr)]
    strings = [v.value for v in values if isinstance(v, ast.Constant) and isinstance(v.value, str)]
    return [part for string in strings for part in paragraphs_of_page(inspect.cleandoc(string))]


def comments(text, mark):
    """Return the paragraphs of comments on lines of their own, each with a capital letter in front."""
    blocks = re.findall(rf"(?:^[ \t]*(?:{mark})(?:[ \t].*)?\n?)+", text, re.MULTILINE)
    plain = [re.sub(rf"^[ \t]*(?:{mark})[ \t]?", "", block, flags=re.MULTILINE) for block in blocks]
    return [part[:1].upper() + part[1:] for block in plain for part in paragraphs_of_page(block)]


def errors(text, suffix):
    """Return the texts of errors, each with a capital letter in front."""
    if suffix == ".py":
        raised = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Raise)]
        values = [getattr(part, "value", None) for node in raised for part in ast.walk(node)]
        strings = [value for value in values if isinstance(value, str)]
    else:
        strings = RUST_ERROR.findall(text)
    return [string[:1].upper() + string[1:] for string in strings]


def page_texts(text, suffix):
    """Return the sentences that the server's page shows: text between tags, titles, and strings that begin like one."""
    if suffix == ".html":
        pairs = re.findall(r""">([^<]+)<(?!/h\d)|(?:title|aria-label)="([^"]*)\"""", text)
    else:
        pairs = re.findall(r'"([A-Z][^"\n]* [^"\n]*)"|`([A-Z][^`\n]* [^`\n]*)`', re.sub(r"\$\{.*?\}", "", text))
    return ["".join(pair).strip() for pair in pairs]


def texts(root):
    """Yield kind, file and paragraphs of everything that is read."""
    roots = [path for name in ("README", "ARCHITECTURE", "CONTRIBUTING") for path in root.glob(f"{name}.md")]
    for path in [*roots, *sorted(root.glob("docs/**/*.md"))]:
        name = path.relative_to(root).as_posix()
        is_generated = name in GENERATED or "/command_line/" in name
        yield "generated pages" if is_generated else "pages", name, paragraphs_of_page(path.read_text())
    for path in root.glob("CHANGELOG.md"):
        yield "changelog", path.name, paragraphs_of_page(path.read_text())
    folders = [root, *(path for path in root.iterdir() if path.is_dir() and path.name not in OTHERS)]
    files = (path for folder in folders for path in folder.glob("*.*" if folder is root else "**/*.*"))
    for path in sorted(path for path in files if path.suffix in {".html", *MARKS} and "vendor" not in path.parts):
        name, suffix = path.relative_to(root).as_posix(), path.suffix
        text = path.read_text()
        if suffix == ".rs":
            yield "comments", name, comments(text, "//[/!]")
        if suffix in MARKS:
            yield "plain comments", name, comments(text, MARKS[suffix])
        if name.startswith("python_client/python/") and suffix == ".py":
            yield "docstrings", name, docstrings(text)
        if (suffix == ".rs" and "/src/" in name) or (suffix == ".py" and name.startswith("python_client/python/")):
            yield "errors", name, errors(text, suffix)
        if name.startswith("server/page/") and suffix in {".html", ".js"}:
            yield "page", name, page_texts(text, suffix)


def relative(paragraphs):
    """Return the sentences that begin with a relative clause."""
    sentences = (sentence for part in paragraphs for sentence in END.split(" ".join(part.split())))
    return [sentence for sentence in sentences if RELATIVE.match(sentence.lstrip('*"'))]


def main(arguments):
    """Print the numbers of every kind; return whether one is beyond its limit."""
    roots = [Path(argument) for argument in arguments if argument != "--list"] or [Path(__file__).parents[1]]
    count = {kind: [0, 0, 0] for kind in LIMITS}
    for kind, name, paragraphs in texts(roots[0]):
        found = relative(paragraphs)
        text = "\n".join(paragraphs)
        for number, more in enumerate((len(found), len(VERBS.findall(text)), len(text.split()))):
            count[kind][number] += more
        for sentence in found:
            if "--list" in arguments or LIMITS[kind][0] == 0:
                print(f"{name}: {sentence[:100]}")
    beyond = False
    for kind, (sentences, verbs, words) in count.items():
        rate = 1000 * verbs / max(words, 1)
        most, highest = LIMITS[kind]
        beyond |= sentences > most or rate > highest
        print(f"{kind}: {sentences} sentences (at most {most}), {rate:.2f} verbs in 1000 words (at most {highest})")
    return int(beyond)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
