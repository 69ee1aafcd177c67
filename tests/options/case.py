"""What a case says: an option, what it is given, and what that must change."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from options.bench import Bench
from options.outcome import Outcome, blocks, differ, differences

#: without the option, with it, the bench
Check = Callable[[Outcome, Outcome, Bench], None]
#: What every command is called with where a case says nothing else.
USUAL: dict[str, tuple[str, ...]] = {
    "lab": ("lab", "<bench.csv>", "--no-loop", "--json"),
    "actigraph": ("actigraph", "<worn.h5>", "--no-loop", "--json"),
    "array": ("array", "<log.h5>", "--board", "<board.yaml>", "--no-loop", "--samples", "40",
              "--json"),
    "imu": ("imu", "<turns.csv>", "--no-loop", "--json"),
    "check": ("check", "<calibration.yaml>", "<bench.csv>", "--json"),
    "compare": ("compare", "<calibration.yaml>", "<own_calibration.yaml>", "--effects", "<own.py>",
                "--json"),
    "fleet": ("fleet", "<norms.csv>", "<norms2.csv>", "--reference", "norm",
              "--only", "quadratic", "--json"),
    "design": ("design", "<bench.csv>", "--json"),
    "inspect": ("inspect", "<samples.csv>", "--json"),
    "noise": ("noise", "<night.h5>", "--json"),
    "apply": ("apply", "<calibration.yaml>", "<samples.csv>", "-o", "<out>/corrected.csv"),
    "export": ("export", "<calibration.yaml>", "--to", "c-header"),
    "convert": ("convert", "<samples.csv>", "<out>/samples.csv"),
    "batch": ("batch", "<cohort.txt>", "-o", "<out>/entries", "--json", "--", "--no-loop"),
    "collect": ("collect", "<entries>", "-o", "<out>/table.csv"),
    "simulate lab": ("simulate", "lab", "<out>/bench.csv", "--positions", "12"),
    "simulate actigraph": ("simulate", "actigraph", "<out>/day.csv", "--days", "0.02", "--rate",
                           "2"),
    "simulate array": ("simulate", "array", "<out>/log.csv", "--board", "<board.yaml>", "--rests",
                       "2", "--seconds", "4", "--rate", "20"),
    "simulate imu": ("simulate", "imu", "<out>/turns.csv", "--rests", "4"),
    "effects": ("effects", "--json"),
    "validate": ("validate", "<calibration.yaml>"),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """command, option : as `tree.every` has them
    given : the option with its value, as typed; typed : the other arguments, () for the usual ones
    check : asserts what the option did
    changes : blocks of the JSON that may change, and no other; None where the check compares all
    """

    command: str
    option: str
    given: tuple[str, ...]
    check: Check
    typed: tuple[str, ...] = ()
    changes: frozenset[str] | None = None

    @property
    def plain(self) -> tuple[str, ...]:
        return self.typed or USUAL[self.command]

    @property
    def whole(self) -> tuple[str, ...]:
        """With the option before what goes to another program."""
        if "--" in self.plain:
            at = self.plain.index("--")
            return (*self.plain[:at], *self.given, *self.plain[at:])
        return (*self.plain, *self.given)

    @property
    def label(self) -> str:
        return f"{self.command.replace(' ', '-')} {' '.join(self.given)}"


@dataclass(frozen=True)
class Of:
    """Makes the cases of one command. typed : arguments of its cases, () for the usual ones"""

    command: str
    typed: tuple[str, ...] = field(default=())

    def __call__(
        self, given: str, check: Check, *typed: str, changes: set[str] | None = None
    ) -> Case:
        words = tuple(given.split(" "))
        option = words[0].partition("=")[0]
        return Case(self.command, option, words, check, typed or self.typed,
                    None if changes is None else frozenset(changes))  # fmt: skip


def gives_what(*arguments: str, rtol: float = 1e-6) -> Check:
    """The result is that of another call: nothing is changed beyond what the option says."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        other = bench.run(arguments)
        assert (done.code, other.code) == (0, 0), done.stderr + other.stderr
        places = differences(done.content, other.content, rtol)
        assert not places, places[:20]

    return check


def numbers_of(*arguments: str, keys: tuple[str, ...]) -> Check:
    """As `gives_what`, for some blocks of the result."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        one, two = done.content, bench.run(arguments).content
        places = [p for k in keys for p in differences(one[k], two[k], 1e-5)]
        assert not places, places[:20]

    return check


def ends(code: int, words: str = "") -> Check:
    """The exit code, and words of the reason."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        assert done.code == code, done.stderr
        assert without.code != code or words not in without.stderr
        assert words in done.stderr

    return check


def writes(*names: str) -> Check:
    """Just these files more than without the option."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        assert done.code == without.code, done.stderr
        assert set(done.files) - set(without.files) == set(names)
        assert set(without.files) <= set(done.files)

    return check


def both(*checks: Check) -> Check:
    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        for one in checks:
            one(without, done, bench)

    return check


def longer(without: Outcome, done: Outcome, bench: Bench) -> None:
    """One screen, and with the option more under the same title."""
    screen, whole = (o.stdout.splitlines() for o in (without, done))
    assert len(screen) <= 60
    assert len(screen) < len(whole)
    assert screen[:2] == whole[:2]


def says_the_cost(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert "s of CPU time" in done.stderr
    assert "s of CPU time" not in without.stderr
    assert not differences(without.content, done.content)


def as_its_kind(bias: float) -> Check:
    """What the fleet knows to a thousandth of a mg stands; what it does not know the data tell."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        before, after = values(without), values(done)
        assert abs(before["bias_x"] - bias) > 0.004 > abs(after["bias_x"] - bias)
        for name in ("bias_y", "bias_z", "scale_y", "scale_z"):
            assert np.isclose(after[name], before[name], rtol=0.02, atol=2e-4), name

    return check


def values(outcome: Outcome) -> dict[str, float]:
    """Parameters of a calibration by name."""
    return {p["name"]: p["value"] for p in outcome.content["parameters"]}


def _told_apart(without: Outcome, done: Outcome) -> bool:
    """Whether results with different numbers say that they were made otherwise."""
    try:
        one, two = without.content, done.content
        kept = [[o["provenance"].get(k) for k in ("settings", "mapping", "seed")]
                for o in (one, two)]  # fmt: skip
    except (json.JSONDecodeError, KeyError, TypeError):
        return True  # text, a refusal, or a command that fits nothing
    # What is proposed next is no number: with an output there is none to be written.
    places = [place for place in differences(one, two) if "/to_do/" not in place]
    return kept[0] != kept[1] or not places


def held(case: Case, bench: Bench) -> None:
    """Assert what a case says."""
    without, done = bench.run(case.plain), bench.run(case.whole)
    assert differ(without, done), "the option changes nothing"
    assert _told_apart(without, done), "what changes a number is not in the provenance"
    if case.changes is not None:
        found = blocks(differences(without.content, done.content))
        assert found == case.changes, found ^ case.changes
    case.check(without, done, bench)
