"""Options that are printed with a name out of a file are taken as they stand: pasted into a shell,
from a line of 80 columns too."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from imucalib.question import paste
from options.outcome import run
from worlds.places import ROOT
from worlds.sheets import bench

#: What a shell and a line of 80 columns would take apart, and "=" and "," what a list would.
ODD = 'Tom\'s "A" $1; (47, 2) & Söhne `x`'
_OPTION = re.compile(r"(?<![\w-])(--[a-z-]+)[ =](?=\S)")


def _rows(path: Path, heading: list[str], rows: list[list[object]]) -> None:
    quoted = (f'"{h.replace(chr(34), chr(34) * 2)}"' for h in heading)
    lines = [";".join(quoted), *(";".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def two_sensors(path: Path) -> None:
    """Positions with angles from the vertical, and readings of two sensors."""
    sheet = bench(1)
    axes = [f"G{axis} {name}" for name in (ODD, "other") for axis in "xyz"]
    g = [[f"{v / 1000:.5f}" for v in (*row, *(row + 3.0))] for row in sheet.reading]
    i, t = sheet.inclination, sheet.tool_face
    _rows(path, ["INC", "TF", *axes], [[90 - a, b, *c] for a, b, c in zip(i, t, g, strict=True)])


def unused(path: Path) -> None:
    """Positions beside a column of numbers and one of words, each with an odd name."""
    sheet, rng = bench(2), np.random.default_rng(0)
    rows = zip(sheet.inclination, sheet.tool_face, sheet.reading.round(3), strict=True)
    heading = ["inclination", "tool_face", "x_mg", "y_mg", "z_mg", f"flow {ODD}", f"who {ODD}"]
    made = [[i, t, *g, f"{rng.normal():.3f}", f"ok {ODD[:7]}" if k % 3 else "no"]
            for k, (i, t, g) in enumerate(rows)]  # fmt: skip
    _rows(path, heading, [[f'"{c.replace(chr(34), chr(34) * 2)}"' if isinstance(c, str) else c
                           for c in row] for row in made])  # fmt: skip


def faces(path: Path) -> None:
    """Two columns that could name the face."""
    sheet = [["+x", 1, 0, 0], ["-x", -1, 0, 0], ["+y", 0, 1, 0], ["-y", 0, -1, 0]] * 3
    _rows(path, [" face ", "Face", "x", "y", "z"], [[row[0], *row] for row in sheet])


def unnamed(path: Path) -> None:
    """A recording whose columns of gravity have odd names."""
    rng = np.random.default_rng(0)
    turn = rng.normal(size=(60, 3)).repeat(20, axis=0)
    g = 9.8 * turn / np.linalg.norm(turn, axis=1)[:, None] + rng.normal(0, 1e-3, turn.shape)
    axes = [f"{a} {ODD.replace(',', '')}" for a in ("p", "q", "r")]
    _rows(path, ["time (s)", *axes], [[f"{k / 20:.2f}", *row.round(4)] for k, row in enumerate(g)])


RUNS: list[tuple[Callable[[Path], None], tuple[str, ...]]] = [
    (two_sensors, ("inspect", "--sensor", ODD)),
    (unused, ()),
    (faces, ("lab", "--reference", "direction", "--no-loop")),
    (unnamed, ()),
]


def options_in(said: str) -> Iterator[tuple[str, str]]:
    """Every option in a text whose value holds a part of an odd name, as a shell takes it."""
    for found in _OPTION.finditer(said):
        words = shlex.shlex(said[found.end() :], posix=True, punctuation_chars=False)
        words.whitespace_split, words.commenters = True, ""
        try:
            value = words.get_token() or ""
        except ValueError as error:  # a quote that does not end
            raise AssertionError(f"{found[1]} {said[found.end() : found.end() + 60]}") from error
        if not value.startswith("-"):  # after a flag
            yield found[1], value


@pytest.mark.parametrize(("make", "typed"), RUNS, ids=lambda one: getattr(one, "__name__", None))
def test_an_option_with_a_name_is_taken(
    make: Callable[[Path], None], typed: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "sheet.csv"
    make(path)
    names = [part.strip('"') for part in path.read_text(encoding="utf-8").split("\n")[0].split(";")]
    odd = [name.replace('""', '"') for name in names]
    given = [*(typed[:1] or ["inspect"]), str(path), *typed[1:]]
    done = run([*given, "--full"], tmp_path)
    said = re.sub(r"imucal .*", "", done.stdout + "\n" + done.stderr)  # whole lines: test_printed
    hints = {
        (option, value)
        for option, value in options_in(said)
        if any(value.rstrip(".,;)").partition("=")[2] in (name, name.strip()) for name in odd)
        or ODD[:8] in value
    }
    assert hints, said
    for option, value in hints:
        command = (
            ["lab", *given[1:], "--no-loop", "--keep-angles"] if option == "--columns" else given
        )
        again = run([*command, option, value], tmp_path)
        assert again.code not in (2, 70), f"{paste(option, value)}\n{again.stderr}"


def test_an_example_of_a_refusal_is_not_refused(tmp_path: Path) -> None:
    """The first line that a table of two sensors prints calibrates one of them."""
    path = tmp_path / "sheet.csv"
    two_sensors(path)
    done = run(["lab", str(path), "--no-loop"], tmp_path)
    assert done.code == 2
    (line,) = re.findall(r"for example: (imucal .+)$", done.stderr, re.M)
    assert run(shlex.split(line)[1:], tmp_path).code in (0, 4, 5)


def test_lines_to_type_are_quoted_in_one_place() -> None:
    source = ROOT / "src" / "imucalib"
    joins = {p.name for p in source.rglob("*.py") if "shlex.join" in p.read_text(encoding="utf-8")}
    assert joins == {"question.py"}
