"""The rooms of the program, from what they import."""

from __future__ import annotations

import ast
from pathlib import Path

import imucalib

ROOT = Path(imucalib.__file__).parent
DESIGN = Path(__file__).parents[1] / "DESIGN.md"
_BEGIN, _END = "<!-- rooms -->\n", "<!-- end of rooms -->"


def page() -> str:
    """DESIGN.md with the rooms as they are."""
    before, _, rest = DESIGN.read_text(encoding="utf-8").partition(_BEGIN)
    after = rest.partition(_END)[2]
    return f"{before}{_BEGIN}{picture()}{_END}{after}".rstrip()


def picture() -> str:
    """A line for each room, the highest first: its floor, what it is for, and the rooms that it
    stands on, without those that one of them stands on in turn."""
    rooms = {path.parent.name: path for path in sorted(ROOT.glob("*/__init__.py"))}
    uses = {name: _imports(path.parent) & rooms.keys() - {name} for name, path in rooms.items()}
    below: dict[str, set[str]] = {}
    floor: dict[str, int] = {}
    while len(floor) < len(rooms):
        ready = [n for n in rooms if n not in floor and uses[n] <= floor.keys()]
        if not ready:
            raise ValueError(f"these import each other: {sorted(rooms.keys() - floor.keys())}")
        for name in ready:
            floor[name] = 1 + max((floor[one] for one in uses[name]), default=0)
            below[name] = uses[name].union(*(below[one] for one in uses[name]))
    lines = []
    for name in sorted(rooms, key=lambda n: (-floor[n], n)):
        on = [one for one in sorted(uses[name]) if not any(one in below[o] for o in uses[name])]
        purpose = (ast.get_docstring(ast.parse(rooms[name].read_text("utf-8"))) or "").split("\n")
        lines.append(f"{floor[name]:2} {name:12} {purpose[0]}")
        lines += [f"{'':15} on {', '.join(on)}"] if on else []
    return "\n".join(["```text", *lines, "```", ""])


def _imports(folder: Path) -> set[str]:
    """First names of the package's modules that a folder imports."""
    trees = (ast.parse(path.read_text("utf-8")) for path in folder.rglob("*.py"))
    nodes = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    names = (str(node.module).split(".") for node in nodes)
    return {parts[1] for parts in names if parts[0] == "imucalib" and len(parts) > 1}
