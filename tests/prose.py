"""Lists sentences whose subject is a relative clause, and counts seven overused verbs, over pages and comments.

python3 tests/prose.py [--list] [FOLDER]

Each kind of text has two limits: such sentences, and those verbs in a thousand words. Pages written by hand have none
of these sentences; the other limits are the numbers of the day on which they were set, and go down only.
"""

import ast
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
RELATIVE = re.compile(r"(?:What|Who|Whoever|Whatever|Whichever|Whose|How|Where|Whether|Of|As)\b(?!.*\?$)", re.DOTALL)
VERBS = re.compile(
    r"\b(?:tell(?:s|ing)?|told|say(?:s|ing)?|said|hold(?:s|ing)?|held|stand(?:s|ing)?|stood|com(?:e|es|ing)|came"
    r"|bear(?:s|ing)?|bore|borne|ask(?:s|ed|ing)?)\b",
    re.IGNORECASE,
)
END = re.compile(r"(?<=[.!?])[*\")]*\s+(?=[A-Z`\"*\[(])")
FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)


def paragraphs_of_page(text):
    """Return the paragraphs and list items of Markdown; no code, headings or tables."""
    text = re.sub(r"\A---\n.*?\n---\n|<!--.*?-->|!\[.*?\]\(.*?\)", "", FENCE.sub("\n", text), flags=re.DOTALL)
    lines = ["" if re.match(r"\s*(?:#|\||\$\$|!!!|</?\w)", line) else line for line in text.splitlines()]
    text = re.sub(r"^\s*(?:[-*>]|\d+\.) ", "\n", "\n".join(lines), flags=re.MULTILINE)
    return re.split(r"\n\s*\n", re.sub(r"\]\([^)]*\)", "]", text).replace("[", "").replace("]", ""))


def paragraphs_of_python(text):
    """Return the paragraphs of all docstrings."""
    holders = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    strings = [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(text)) if isinstance(node, holders)]
    return [part for string in strings for part in paragraphs_of_page(string)]


def paragraphs_of_rust(text):
    """Return the paragraphs of all documentation comments."""
    blocks = re.findall(r"(?:^[ \t]*//[/!](?!/).*\n?)+", text, re.MULTILINE)
    plain = [re.sub(r"^[ \t]*//[/!] ?", "", block, flags=re.MULTILINE) for block in blocks]
    return [part for block in plain for part in paragraphs_of_page(block)]


def texts(root):
    """Yield kind, file and paragraphs of everything that is read."""
    roots = [path for name in ("README", "ARCHITECTURE", "CONTRIBUTING") for path in root.glob(f"{name}.md")]
    for path in [*roots, *sorted(root.glob("docs/**/*.md"))]:
        name = path.relative_to(root).as_posix()
        is_generated = name in GENERATED or "/command_line/" in name
        yield "generated pages" if is_generated else "pages", name, paragraphs_of_page(path.read_text())
    for path in root.glob("CHANGELOG.md"):
        yield "changelog", path.name, paragraphs_of_page(path.read_text())
    for path in sorted(root.glob("python_client/python/**/*.py")):
        yield "docstrings", path.relative_to(root).as_posix(), paragraphs_of_python(path.read_text())
    for path in sorted(root.glob("*/**/*.rs")):
        if "target" not in path.parts:
            yield "comments", path.relative_to(root).as_posix(), paragraphs_of_rust(path.read_text())


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
