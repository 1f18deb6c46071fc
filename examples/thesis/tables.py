"""Tables as text and as Markdown."""

MARK = "<!-- tables -->"


def number(value, decimals):
    """Return a number with so many decimals; no minus before a zero."""
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def plain(header, rows, left=()):
    """Return columns padded with spaces; the first and those in `left` are flush left."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    lines = []
    for row in [header, *rows]:
        cells = enumerate(zip(row, widths, strict=True))
        lines.append("  ".join(text.ljust(n) if i in (0, *left) else text.rjust(n) for i, (text, n) in cells).rstrip())
    return "\n".join(lines) + "\n"


def markdown(header, rows, left=()):
    """Return the same as Markdown; a bar within a cell is escaped."""
    rule = ["---" if i in (0, *left) else "---:" for i in range(len(header))]
    lines = ["| " + " | ".join(text.replace("|", "\\|") for text in row) + " |" for row in [header, *rows]]
    return "\n".join([lines[0], f"|{'|'.join(rule)}|", *lines[1:]]) + "\n"


def filled(page, tables):
    """Return the text of a page with these tables between its two marks."""
    before, _, after = page.read_text().split(MARK)
    return f"{before}{MARK}\n{tables.strip()}\n{MARK}{after}"
