"""Cases of the commands of a cohort: batch and collect."""

from __future__ import annotations

import csv

from options.bench import Bench
from options.case import Case, Of, both, ends, writes
from options.outcome import Outcome

BATCH, COLLECT = Of("batch"), Of("collect")


def _batch(*more: str) -> tuple[str, ...]:
    return ("batch", "<cohort.txt>", "-o", "<out>/entries", "--json", *more, "--", "--no-loop")


def _entries(outcome: Outcome) -> set[str]:
    return {name for name in outcome.files if name.endswith(".json")}


def _one_of_two(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The second of two recordings, and with the first shard both."""
    first = bench.run(_batch("--shard", "1/2"))
    assert len(_entries(done)) == len(_entries(first)) == 1
    assert _entries(first) | _entries(done) == _entries(without)
    assert (first.content["recordings"], done.content["recordings"]) == (1, 1)


def _by_lab(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Worn recordings are no tables of angles: the command of the name ran."""
    assert without.content["calibrated"] == 2
    assert done.code == 3
    assert done.content["calibrated"] == 0


def _again(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert without.content["reused"] == 2
    assert done.content["reused"] == 0
    assert done.content["calibrated"] == 2


def _alike(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Two processes write what one does."""
    assert done.content["calibrated"] == 2
    assert _entries(done) == _entries(without)


def _table(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The last -o is where the table goes, a row a recording."""
    assert set(done.files) == {"other.csv"}
    with (done.folder / "other.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 2


def _page(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Every recording of the table stands on it."""
    with (done.folder / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    page = done.text("page.html")
    assert len(rows) == 2
    assert all(row["recording"] in page for row in rows)


def _corrected(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Two recordings as `imucal apply` corrects them, by the calibrations beside the entries."""
    made = {n for n in done.files if n.startswith("corrected/")}
    assert made == {"corrected/worn1.h5", "corrected/worn2.h5"}
    assert set(done.files) - made == set(without.files)
    (own,) = (n for n in done.files if n.startswith("entries/worn1") and n.endswith(".yaml"))
    target = done.folder / "again.h5"
    typed = ("apply", str(done.folder / own), str(bench.path("worn1.h5")), "-o", str(target))
    assert bench.run(typed).code == 0
    assert target.read_bytes() == (done.folder / "corrected/worn1.h5").read_bytes()


def _for_ggir(without: Outcome, done: Outcome, bench: Bench) -> None:
    """A row each of both recordings, by their names."""
    head, *lines = done.text("g.csv").splitlines()
    assert [line.partition(",")[0] for line in lines] == ["worn1.h5", "worn2.h5"]
    assert head.startswith("filename,")


def _all_columns(without: Outcome, done: Outcome, bench: Bench) -> None:
    """A paper's columns, and all others."""
    few, every = (
        set((one.folder / "table.csv").read_text().splitlines()[0].split(","))
        for one in (without, done)
    )
    assert few < every
    assert {"bias_x", "bias_x_sd", "status", "what_to_do"} <= every - few


KEPT = ("batch", "<cohort.txt>", "-o", "<entries>", "--json", "--", "--no-loop")
CASES: tuple[Case, ...] = (
    BATCH("--output <out>/others", lambda a, b, c: _moved(a, b)),
    BATCH("--corrected <out>/corrected", _corrected),
    BATCH("--calibrator lab", _by_lab),
    BATCH("--jobs 2", _alike),
    BATCH("--shard 2/2", _one_of_two),
    BATCH("--shard 3", ends(2, "is not I/N")),
    BATCH("--no-resume", _again, *KEPT),
    COLLECT("--output <out>/other.csv", _table),
    COLLECT("--all-columns", _all_columns),
    COLLECT("--ggir <out>/g.csv", both(writes("g.csv"), _for_ggir)),
    COLLECT("--html <out>/page.html", both(writes("page.html"), _page)),
)


def _moved(without: Outcome, done: Outcome) -> None:
    assert {n.partition("/")[2] for n in _entries(done)} == {
        n.partition("/")[2] for n in _entries(without)
    }
    assert all(n.startswith("others/") for n in done.files)
