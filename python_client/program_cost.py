"""What a compiled JAX program costs, read from its text: kernels that run, and bytes that they read and write."""

import re
from typing import NamedTuple

_WIDTHS = {"pred": 1, "s8": 1, "u8": 1, "f16": 2, "bf16": 2, "s64": 8, "u64": 8, "f64": 8}
# these move nothing
_FREE = ("parameter", "constant", "tuple", "get-tuple-element", "bitcast", "opt-barrier", "after-all", "partition-id")
_HEAD = re.compile(r"^(ENTRY )?%(\S+) \(.*\{$")
_LINE = re.compile(r"^\s+(?:ROOT )?%(\S+) = (\(.*?\)|\S+) ([a-z-]+)\((.*)$")


class Cost(NamedTuple):
    """Kernels, and bytes of memory."""

    kernels: int
    moved: int


def _size(shape):
    """Return the bytes of a shape, or of a tuple of them."""
    total = 0
    for kind, lengths in re.findall(r"(\w+)\[([\d,]*)\]", shape):
        count = _WIDTHS.get(kind, 4)
        for length in filter(None, lengths.split(",")):
            count *= int(length)
        total += count
    return total


def _computations(text):
    """Return the entry's name, and each computation's instructions: name, shape, operation, rest of the line."""
    entry, found, own = None, {}, []
    for line in text.splitlines():
        if head := _HEAD.match(line):
            own = found[head[2]] = []
            entry = head[2] if head[1] else entry
        elif instruction := _LINE.match(re.sub(r"/\*.*?\*/", "", line)):
            own.append(instruction.groups())
    return entry, found


def _names(text):
    return re.findall(r"%([\w.-]+)", text)


def _moved(found, instruction, sizes):
    """Return the bytes that a kernel moves: of what it takes a part of, it reads that part alone."""
    own, _, _, rest = instruction
    inside = [found[name] for name in re.findall(r"calls=%([\w.-]+)", rest)]
    parts = inside[0] if inside else [instruction]
    operands = _names(rest.split(")")[0])
    places = {int(rest.split(")")[0]): name for name, _, operation, rest in parts if operation == "parameter"}
    inner = [places[i] for i in sorted(places)] if inside else operands
    total = sizes[own]
    for outer, name in zip(operands, inner, strict=False):
        users = [(shape, operation) for _, shape, operation, rest in parts if name in _names(rest.split(")")[0])]
        part = sum(_size(shape) for shape, _ in users)
        taken = all(operation in ("slice", "dynamic-slice", "gather") for _, operation in users)
        total += min(part, sizes.get(outer, 0)) if taken else sizes.get(outer, 0)
    return total


def _cost(found, name):
    """Return what a computation costs."""
    sizes = {own: _size(shape) for own, shape, _, _ in found[name]}
    kernels = moved = 0
    for instruction in found[name]:
        _, _, operation, rest = instruction
        called = _names(" ".join(re.findall(r"(?:to_apply|body|_computations?)=(\{.*?\}|\S+)", rest)))
        if operation in _FREE:
            continue
        rounds, cost = 1, Cost(1, _moved(found, instruction, sizes))
        if operation in ("while", "call", "conditional"):
            rounds = int(next(iter(re.findall(r'known_trip_count":\{"n":"(\d+)"', rest)), 1))
            # the more expensive branch
            cost = max((_cost(found, one) for one in called), key=lambda cost: cost.moved)
        kernels, moved = kernels + rounds * cost.kernels, moved + rounds * cost.moved
    return Cost(kernels, moved)


def program_cost(compiled):
    """Return the cost of a compiled program: each kernel reads its operands and writes its results once.

    Loops count as often as they run where that is known. A condition goes the dearer way.
    """
    entry, found = _computations(compiled.as_text())
    return _cost(found, entry)
