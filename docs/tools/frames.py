"""The drawing of axes, angles and motors, as SVG text. `make pictures` writes it to docs/pictures/frames.svg."""

import math

# colours of Okabe and Ito suit colour-blind people; each axis also has its letter
RED, GREEN, BLUE, GREY, INK = "#d55e00", "#009e73", "#0072b2", "#8a8f98", "#1b1f24"
WIDTH, HEIGHT, PANEL = 960, 420, 320
# number, place along x (forward) and y (left), sense of rotation from above
MOTORS = [
    (1, 1, -1, "counter-clockwise"),
    (2, -1, -1, "clockwise"),
    (3, -1, 1, "counter-clockwise"),
    (4, 1, 1, "clockwise"),
]


def draw_frames():
    """Return the drawing: from above, from the right side, from behind."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
        f'font-size="17" fill="{INK}" role="img" aria-label="Axes, positive angles and motors of the vehicle">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
        "<defs>",
        *(
            f'<marker id="{name}" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
            f'<path d="M0 0 L10 5 L0 10 z" fill="{colour}"/></marker>'
            for name, colour in (("r", RED), ("g", GREEN), ("b", BLUE), ("k", INK))
        ),
        "</defs>",
        *_from_above(PANEL / 2, 215),
        *_tilted(PANEL * 1.5, 205, "from the right side", "x, forward", RED, "r", "+pitch: nose down", 14),
        *_tilted(PANEL * 2.5, 205, "from behind", "y, left", GREEN, "g", "+roll: right side down", 14, mirrored=True),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _from_above(x, y):
    arm = 74
    yield _text(x, 34, "from above", size=20, weight="bold")
    for number, forward, left, sense in MOTORS:
        mx, my = x - left * arm, y - forward * arm
        yield f'<line x1="{x}" y1="{y}" x2="{mx}" y2="{my}" stroke="{GREY}" stroke-width="9"/>'
        yield f'<circle cx="{mx}" cy="{my}" r="38" fill="#eef1f5" stroke="{GREY}" stroke-width="1.5"/>'
        yield _arc(mx, my, 29, 200, 340, "k", INK, clockwise=sense == "clockwise")
        yield _text(mx, my + 8, f"m{number}")
    yield f'<rect x="{x - 19}" y="{y - 19}" width="38" height="38" rx="6" fill="{INK}"/>'
    yield _arrow(x, y, x, y - 150, RED, "r")
    yield _text(x + 14, y - 138, "x, forward", RED, anchor="start")
    yield _arrow(x, y, x - 138, y, GREEN, "g")
    yield _text(x - 138, y - 14, "y, left", GREEN, anchor="start")
    yield f'<circle cx="{x}" cy="{y}" r="8" fill="#ffffff" stroke="{BLUE}" stroke-width="2.5"/>'
    yield f'<circle cx="{x}" cy="{y}" r="2.5" fill="{BLUE}"/>'
    yield _text(x + 30, y + 6, "z, up", BLUE, anchor="start")
    yield _text(x, 352, "+yaw: counter-clockwise")
    yield _text(x, 376, "but a commanded yaw rate of +")
    yield _text(x, 400, "turns clockwise (5.2)")


def _tilted(x, y, title, name, colour, marker, angle, degrees, mirrored=False):
    """A side view of the vehicle at a positive angle, its axis pointing to the right, or to the left if mirrored."""
    side = -1 if mirrored else 1
    yield _text(x, 34, title, size=20, weight="bold")
    yield f'<line x1="{x - 118}" y1="{y}" x2="{x + 118}" y2="{y}" stroke="{GREY}" stroke-dasharray="6 6"/>'
    # a positive pitch lowers the nose, which points right; a positive roll lowers the right side, seen from behind
    yield f'<g transform="rotate({degrees} {x} {y})">'
    yield f'<line x1="{x - 74}" y1="{y}" x2="{x + 74}" y2="{y}" stroke="{GREY}" stroke-width="9"/>'
    for place in (-74, 74):
        yield f'<rect x="{x + place - 4}" y="{y - 18}" width="8" height="18" fill="{GREY}"/>'
        yield f'<ellipse cx="{x + place}" cy="{y - 20}" rx="38" ry="5" fill="#cfd6df" stroke="{GREY}"/>'
    yield f'<rect x="{x - 22}" y="{y - 12}" width="44" height="22" rx="6" fill="{INK}"/>'
    yield f'<path d="M{x - 8} {y + 10} h16 l5 14 h-26 z" fill="{GREY}"/>'
    yield _arrow(x, y, x + side * 132, y, colour, marker)
    yield _arrow(x, y, x, y - 118, BLUE, "b")
    yield "</g>"
    yield _text(x + side * 106, y - 62 if mirrored else y + 66, name, colour)
    yield _text(x + 44, y - 116, "z", BLUE)
    yield _arc(x, y, 104, 0, degrees, "k", INK, clockwise=True)
    push = x + 60
    yield _arrow(push - 30, 312, push + 44, 312, INK, "k")
    yield _text(push - 40, 318, "accelerates", anchor="end")
    yield _text(x, 352, angle)
    yield _text(x, 376, "acceleration: +g pitch along x" if not mirrored else "acceleration: -g roll along y")


def _arrow(x1, y1, x2, y2, colour, marker):
    return f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="{colour}" stroke-width="3.5" marker-end="url(#{marker})"/>'


def _arc(x, y, radius, start_deg, end_deg, marker, colour, clockwise):
    """An arc with an arrow; angles grow clockwise on the screen, from the right."""
    if not clockwise:
        start_deg, end_deg = end_deg, start_deg
    ends = [
        f"{x + radius * math.cos(math.radians(a)):.1f} {y + radius * math.sin(math.radians(a)):.1f}"
        for a in (start_deg, end_deg)
    ]
    sweep = int(clockwise)
    return (
        f'<path d="M{ends[0]} A{radius} {radius} 0 0 {sweep} {ends[1]}" fill="none" stroke="{colour}" '
        f'stroke-width="2" marker-end="url(#{marker})"/>'
    )


def _text(x, y, text, colour=INK, anchor="middle", size=17, weight="normal"):
    return (
        f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="{colour}" font-size="{size}" font-weight="{weight}">'
        f"{text}</text>"
    )
