"""Whatever changes a number stands in the provenance: found over the command tree.

The work of a calibrating command is stopped where it begins, and what it was asked is read: what
provenance keeps of it must differ with the option. How a recording is read is its mapping, which
`test_each` holds to the same.
"""

from __future__ import annotations

import hashlib
import re
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import pytest

from imucalib import effects
from imucalib.cli.frame.calibrating import is_calibrator
from imucalib.errors import UnreadableInput
from options.bench import Bench
from options.cases import cases
from options.listed import LAWS, reading
from options.outcome import run
from options.tree import commands, options_of, spellings

#: Where the work of a command begins: one of its arguments states what was asked.
BEGINS: dict[str, tuple[str, ...]] = {
    "lab": ("imucalib.calibrators.lab.files.calibrate_files",),
    "actigraph": (
        "imucalib.calibrators.actigraph.run.calibrate_recording",
        "imucalib.calibrators.actigraph.published.calibrate_as_published",
    ),
    "array": ("imucalib.calibrators.array.calibrate.calibrate_array",),
    "imu": ("imucalib.calibrators.imu.run.run_imu",),
    "fleet": (
        "imucalib.cohort.fleet.run.run_fleet",
        "imucalib.cohort.fleet.recorded.run_recorded",
    ),
}
#: What is printed, and where; and what only names other inputs, which have their own check sums.
NO_NUMBER = {*LAWS, "--output", "--entry", "--full", "--verbose", "--export", "--save-draws"}
NO_NUMBER |= {"--recording"}
#: What a run ends with.
NO_NUMBER |= {"--fail-on"}
#: The headings of a table: in the mapping, as they were taken.
NO_NUMBER |= {"--columns"}


class Stopped(UnreadableInput):
    """Raised where the work begins."""


def asked(name: str, arguments: tuple[str, ...], bench: Bench, folder: Path) -> Any:
    """What provenance would keep, or None where the command refuses before any work."""
    told: list[dict[str, object]] = []

    def stop(*given: Any) -> NoReturn:
        (request,) = (one for one in given if hasattr(one, "describe_settings"))
        told.append({"seed": getattr(request, "seed", None), **request.describe_settings()})
        raise Stopped("stopped")

    typed = [re.sub(r"<(?!out)([^<>]+)>", lambda m: str(bench.path(m[1])), a) for a in arguments]
    with pytest.MonkeyPatch.context() as patch:
        for place in BEGINS[name]:
            module, _, function = place.rpartition(".")
            patch.setattr(import_module(module), function, stop)
        run([a.replace("<out>", str(folder)) for a in typed], folder)
    return told[0] if told else None


PAIRS = [
    (name, option)
    for name, command in commands().items()
    if is_calibrator(command) or name in BEGINS
    for option in options_of(command)
    if option not in NO_NUMBER and option not in reading()
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "option"), PAIRS)
def test_what_changes_a_number_is_in_the_provenance(
    name: str, option: str, bench: Bench, tmp_path: Path
) -> None:
    names = spellings(commands()[name])
    own = [c for c in cases() if c.command == name and names[c.option] == option]
    kept = []
    for k, case in enumerate(own):
        folder = tmp_path / str(k)
        kept.append([asked(name, a, bench, folder) for a in (case.plain, case.whole)])
    reached = [(without, done) for without, done in kept if done]
    assert reached, "no case of it comes to the work"
    assert all(without != done for without, done in reached), reached


@pytest.mark.parametrize("name", [name for name, option in PAIRS if option == "--effects"])
def test_effects_of_ones_own_are_told_from_others_of_their_names(
    name: str, bench: Bench, tmp_path: Path
) -> None:
    """By the check sum of their file: a changed constant leaves every name as it is."""
    (case,) = (c for c in cases() if c.command == name and c.option == "--effects")
    own, out = tmp_path / "own.py", tmp_path / "out"
    kept = []
    for extra in ("", "# changed\n"):
        own.write_text(bench.path("own.py").read_text(encoding="utf-8") + extra, encoding="utf-8")
        effects._LOADED.clear()
        told = asked(name, tuple(a.replace("<own.py>", str(own)) for a in case.whole), bench, out)
        digest = hashlib.sha256(own.read_bytes()).hexdigest()
        assert told["own_effects"]
        assert all((e["file"], e["sha256"]) == ("own.py", digest) for e in told["own_effects"])
        kept.append([e["name"] for e in told["own_effects"]])
    assert kept[0] == kept[1]
