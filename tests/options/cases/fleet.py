"""Cases of `imucal fleet`: two devices by the size of gravity, a search of one effect."""

from __future__ import annotations

from typing import Any

import numpy as np

from options.bench import Bench
from options.case import USUAL, Case, Check, Of, ends, longer, says_the_cost
from options.cases.calibrating_block import normal_gravity
from options.outcome import Outcome

FLEET = Of("fleet")
PLAIN = USUAL["fleet"]


def _on(*names: str) -> tuple[str, ...]:
    return ("fleet", *(f"<{n}>" for n in names), *PLAIN[3:])


def _without(*words: str) -> tuple[str, ...]:
    """The usual call, some words and their values left out."""
    out = list(PLAIN)
    for word in words:
        at = out.index(word)
        del out[at : at + 2]
    return tuple(out)


def _numbers(outcome: Outcome) -> list[Any]:
    assert outcome.code in (0, 5), outcome.stderr
    return [(d["parameter"], d["mean"]) for d in outcome.content["between_devices"]]


def _like(*arguments: str) -> Check:
    """What all devices share is that of another call."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        names, values = zip(*_numbers(done), strict=True)
        others, expected = zip(*_numbers(bench.run(arguments)), strict=True)
        assert names == others
        np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-9)

    return check


def _scales(outcome: Outcome) -> np.ndarray:
    return np.array([1.0 + v for n, v in _numbers(outcome) if n.startswith("scale")])


def _weaker(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The same readings under less gravity are of a sensor that reads more."""
    np.testing.assert_allclose(_scales(done) / _scales(without), 9.80665 / 9.75, rtol=1e-4)


def _tried(outcome: Outcome) -> set[str]:
    return {t["effect"] for t in outcome.content["tried"]}


def _only_that(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert _tried(done) == {"cubic"} < _tried(without)


def _not_that(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert _tried(without) - _tried(done) == {"cubic"}


def _no_mounting(without: Outcome, done: Outcome, bench: Bench) -> None:
    names = [[n for n, _ in _numbers(o)] for o in (without, done)]
    assert [n for n in names[0] if not n.startswith("mounting")] == names[1]
    assert len(names[1]) == 9


def _written(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert set(done.files) == {"report.html", "report.json", "norms/calibration.yaml",
                               "norms2/calibration.yaml"}  # fmt: skip
    assert not without.files


def _devices_named(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The same two, by the names of the table."""
    for outcome, expected in ((without, ["worn1", "worn2"]), (done, ["left", "right"])):
        assert [d["name"] for d in outcome.content["devices"]] == expected
    assert _numbers(without) == _numbers(done)


WORDS = tuple(a for a in PLAIN if a != "--json")
CASES: tuple[Case, ...] = (
    FLEET("--output <out>", _written),
    FLEET("--reference norm", _no_mounting, "fleet", "<bench.csv>", "<aligned.csv>", *PLAIN[5:]),
    FLEET("--columns x=p,y=q,z=r", _like(*PLAIN), *_on("norms_abc.csv", "norms2_abc.csv")),
    FLEET("--exclude 3", _like(*_on("norms_short.csv", "norms2_short.csv"))),
    FLEET("--only cubic", _only_that, *_without("--only")),
    FLEET("--without cubic", _not_that, *_without("--only")),
    FLEET("--devices <devices.csv>", _devices_named, "fleet", "<entries>", "--json"),
    FLEET("--full", longer, *WORDS),
    FLEET("--gravity 9.75", _weaker),
    FLEET("--latitude 46.3", _like(*PLAIN, "--gravity", repr(normal_gravity(46.3, 0.0)))),
    FLEET("--height 3000", _like(*PLAIN, "--gravity", repr(normal_gravity(46.3, 3000.0))),
          *PLAIN, "--latitude", "46.3"),
    FLEET("--shortest-rest 100", ends(2, "18 too short"), *_on("rests.csv", "rests2.csv")),
    FLEET("--verbose", says_the_cost),
)  # fmt: skip
