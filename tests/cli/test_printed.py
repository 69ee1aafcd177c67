"""Every command that is printed runs as it stands: pasted into a shell, in an empty folder."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

from options.bench import FILES
from options.outcome import Outcome, run

#: What a run is given, "<name>" an input; the fast ones first.
RUNS = {
    "a table": ("<bench.csv>",),
    "angles from the vertical": ("<drilling.csv>",),
    "angles in rad": ("<radians.csv>",),
    "angle columns exchanged": ("<swapped_angles.csv>",),
    "turned axes": ("<axes.csv>",),
    "norms": ("<norms.csv>",),
    "a plan": ("<angles.csv>",),
    "rests": ("<rests.csv>",),
    "turns": ("<turns.csv>",),
    "a worn sensor": ("<worn.h5>",),
    "an array": ("<log.h5>",),
    "counts": ("<counts.csv>",),
    "two sensors": ("<worn_twice.h5>",),
    "a calibration": ("<calibration.yaml>",),
    "noise": ("noise", "<night.h5>"),
    "lab, no search": ("lab", "<bench.csv>", "--no-loop", "-o", "<out>"),
    "lab, in rad": ("lab", "<radians.csv>"),
    "lab, a plan": ("design", "<angles.csv>"),
    "check": ("check", "<calibration.yaml>", "<first12.csv>"),
    "one of two": ("actigraph", "<worn_twice.h5>", "-o", "<out>"),
}
SLOW = {
    "lab, a slip": ("lab", "<slip.csv>", "-o", "<out>"),
    "lab, a mistyped cell": ("lab", "<mistyped.csv>", "-o", "<out>"),
    "lab, a jump": ("lab", "<jumped.csv>", "-o", "<out>"),
    "lab, rows exchanged": ("lab", "<exchanged.csv>", "-o", "<out>"),
    "lab, turned axes": ("lab", "<axes.csv>", "-o", "<out>"),
    "lab, counts": ("lab", "<in_counts.csv>", "-o", "<out>"),
    "lab, two logs": ("lab", "<norms.csv>", "<norms2.csv>", "--reference", "norm", "-o", "<out>"),
    "imu": ("imu", "<turns.csv>", "-o", "<out>"),
    "imu, without stamps": ("imu", "<unstamped_turns.csv>", "--rate", "100", "-o", "<out>"),
    "imu, turned axes": ("imu", "<turned_axes.csv>", "-o", "<out>"),
    "imu, two logs": ("imu", "<turns.csv>", "<turns.csv>", "-o", "<out>"),
    "array": ("array", "<log.h5>", "--board", "<board.yaml>", "-o", "<out>"),
    "actigraph": ("actigraph", "<worn.h5>", "-o", "<out>"),
    "fleet": ("fleet", "<norms.csv>", "<norms2.csv>", "--reference", "norm", "-o", "<out>"),
    "compare": ("compare", "<calibration.yaml>", "<calibration.yaml>"),
}
#: Words that stand for what only the reader has.
_HIS = re.compile(r"(?<![\w./-])[A-Z]{3,}\b(?!\.)")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In a folder whose name a shell would split."""
    folder = tmp_path_factory.mktemp("printed") / "of Jörg & Söhne"
    folder.mkdir()
    return folder


def typed(words: tuple[str, ...], inputs: Path, out: Path) -> list[str]:
    def place(found: re.Match[str]) -> str:
        if found[1] == "out":
            return str(out)
        if not (path := inputs / found[1]).exists():
            FILES[found[1]](path)
        return str(path)

    return [re.sub(r"<([^<>]+)>", place, word) for word in words]


def printed(done: Outcome, out: Path) -> list[str]:
    """Commands in what a run said and wrote, but those with a place for the reader's own."""
    said = done.stdout + "\n" + done.stderr
    pasted = re.sub(r" \\\n\s*", " ", said)
    found = re.findall(r"^\s*(?:\d\.)?\s*(imucal .+)$", pasted, re.M)
    found += re.findall(r"for example: (imucal .+)$", said, re.M)
    for report in sorted(out.rglob("report.json")):
        steps = json.loads(report.read_text(encoding="utf-8"))["card"]["to_do"]
        found += [command for step in steps for command in re.findall(r"`(imucal .+?)`", step)]
    found += re.findall(r"`(imucal [^`]+)`", said)
    return [one.strip() for one in dict.fromkeys(found) if not _HIS.search(one)]


def runs(command: str, folder: Path) -> str:
    """Why a line does not run, pasted into a shell; empty where it does."""
    words = list(shlex.shlex(command, posix=True, punctuation_chars=True))
    if set("();<>|&") & {word[0] for word in words if len(set(word) - set("();<>|&")) == 0}:
        return "a shell would take it apart"
    done = run(shlex.split(command)[1:], folder)
    return "" if done.code in (0, 1, 4, 5, 6) else f"exit {done.code}: {done.stderr}"


@pytest.mark.parametrize(
    "words",
    [
        *(pytest.param(words, id=name) for name, words in RUNS.items()),
        *(pytest.param(w, id=n, marks=pytest.mark.slow) for n, w in SLOW.items()),
    ],
)
def test_what_is_printed_runs(
    words: tuple[str, ...], inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In turn, in one folder, as a reader goes down the page."""
    out = tmp_path / "here & there"
    monkeypatch.chdir(tmp_path)
    done = run(typed(words, inputs, out), tmp_path)
    assert done.code != 70
    for command in printed(done, out):
        why = runs(command, tmp_path)
        assert not why, f"{command}\n{why}"
        shutil.rmtree(tmp_path / "out", ignore_errors=True)  # where the next one writes, too


@pytest.mark.slow
def test_what_was_stated_of_a_log_holds_for_later_ones(inputs: Path, tmp_path: Path) -> None:
    """A log of the same logger, whose rate was stated when it was calibrated."""
    calibration, rate = tmp_path / "out" / "calibration.yaml", ("--rate", "50")
    (log,) = typed(("<unstamped_rests.csv>",), inputs, tmp_path)
    made = run(["lab", log, "--reference", "norm", "--no-loop", *rate, "-o", str(tmp_path / "out")],
               tmp_path)  # fmt: skip
    assert made.code in (0, 4, 5), made.stderr
    for words in (("check", str(calibration), log, "--json"),
                  ("apply", str(calibration), log, "-o", str(tmp_path / "a.csv"))):  # fmt: skip
        stated = run([*words, *rate], tmp_path)
        assert "read as what was calibrated" not in stated.stderr
        found = tmp_path / "a.csv"
        rows = found.read_text(encoding="utf-8") if found.exists() else ""
        again = run([*words, *(("--force",) if rows else ())], tmp_path)
        assert again.stderr.count("neither time stamps nor a sample rate: read as") == 1
        assert (again.code, again.stdout) == (stated.code, stated.stdout.replace(" --rate 50", ""))
        assert not rows or found.read_text(encoding="utf-8") == rows
