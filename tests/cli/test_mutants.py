"""A damaged calibration is refused by all commands that read one, or by none; none crashes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from imucalib.exports import exports
from imucalib.readers import read
from imucalib.recording.recording import Recording
from imucalib.recording.yaml_text import dump, load
from imucalib.writers import write
from worlds.calibrations import INPUTS
from worlds.command import run
from worlds.mutants import mutants

REFUSED, KNOWN = 3, (0, 1, 2, 3, 4, 5, 6)
#: Leaves that are changed in each file.
COUNT = 12


@dataclass(frozen=True)
class Own:
    """A calibration, its content, and the first seconds of its recording."""

    path: Path
    content: dict[str, Any]
    short: Path


@pytest.fixture(scope="module", params=sorted(INPUTS))
def own(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Own:
    folder = tmp_path_factory.mktemp(request.param)
    given = INPUTS[request.param](folder)
    out = folder / "out"
    run(request.param, given.recording, *given.options, "-q", "-o", out)
    short = folder / "short.h5"
    write(beginning(read(given.recording)), short)
    path = out / "calibration.yaml"
    return Own(path, load(path), short)


def beginning(whole: Recording) -> Recording:
    """Its first 25 s."""
    channels = {
        name: replace(c, t=c.t[c.t < 25.0], values=c.values[c.t < 25.0])
        for name, c in whole.channels.items()
    }
    return replace(whole, channels=channels)


def calls(own: Own, changed: Path, out: Path) -> dict[str, tuple[object, ...]]:
    """Every command that reads a calibration."""
    found: dict[str, tuple[object, ...]] = {
        "validate": ("validate", changed),
        "apply": ("apply", changed, own.short, "-o", out / "c.h5", "--force", "--same-device"),
        "check": ("check", changed, own.short, "--same-device"),
        "compare": ("compare", changed, own.path),
        "inspect": ("inspect", changed),
    }
    for form in exports():
        found[form] = ("export", changed, "--to", form, "--force")
    return found


def judged(own: Own, content: dict[str, Any], out: Path) -> dict[str, Any]:
    """Exit code of each command; what is no failure of ours is a crash, by its name."""
    changed = out / "changed.yaml"
    changed.write_text(dump(content), encoding="utf-8")
    codes = {}
    for name, words in calls(own, changed, out).items():
        done = run(*words, "-q")
        codes[name] = repr(done.exception) if done.return_value is None else done.return_value
    return codes


def demand_one_word(what: str, codes: dict[str, Any]) -> None:
    """No crash; and what `validate` refuses, all refuse, what it accepts, none calls damaged."""
    assert all(code in KNOWN for code in codes.values()), (what, codes)
    read_by = {name: code for name, code in codes.items() if name != "inspect"}
    if codes["validate"] == REFUSED:
        assert set(read_by.values()) == {REFUSED}, (what, codes)
    else:
        assert REFUSED not in read_by.values(), (what, codes)


@pytest.mark.slow
def test_a_changed_leaf_is_refused_by_all_or_by_none(own: Own, tmp_path: Path) -> None:
    whole = judged(own, own.content, tmp_path)
    assert whole["validate"] == 0
    for what, content in mutants(own.content, COUNT, seed=1):
        demand_one_word(what, judged(own, content, tmp_path))
