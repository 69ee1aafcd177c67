"""Where the cases run: a folder with their inputs, and every run that was made, made once."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from options.inputs import TABLES, Make
from options.outcome import Outcome, run
from options.recordings import RECORDINGS

FILES: dict[str, Make] = {**TABLES, **RECORDINGS}


class Bench:
    """Runs of the command; "<name>" in an argument is an input's path, "<out>" the run's folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._runs: dict[tuple[str, ...], Outcome] = {}
        (folder / "inputs").mkdir()

    def path(self, name: str) -> Path:
        """An input, made when it is first asked for."""
        path = self.folder / "inputs" / name
        if not path.exists():
            FILES[name](path)
        return path

    def run(self, arguments: Iterable[str], *, again: bool = False) -> Outcome:
        """A run in a folder of its own; the same arguments are run once unless `again`."""
        typed = tuple(arguments)
        if again or typed not in self._runs:
            out = self.folder / f"run{len(self._runs)}"
            self._runs[typed] = run([self._filled(a, out) for a in typed], out)
        return self._runs[typed]

    def _filled(self, argument: str, out: Path) -> str:
        def place(found: re.Match[str]) -> str:
            return str(out if found[1] == "out" else self.path(found[1]))

        return re.sub(r"<([^<>]+)>", place, argument)
