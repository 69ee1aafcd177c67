"""Cases of `imucal check` and `imucal compare`: a later recording, another calibration."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from options.bench import Bench
from options.case import USUAL, Case, Check, Of, ends, gives_what
from options.cases.calibrating_block import normal_gravity
from options.inputs import direction, rows
from options.outcome import Outcome

CHECK = Of("check")
PLAIN = USUAL["check"]
#: What the crossed table's z reads of the product of x and y, mg/g².
CROSS = 30.0


def _on(log: str, calibration: str = "calibration.yaml") -> tuple[str, ...]:
    return ("check", f"<{calibration}>", f"<{log}>", "--json")


def _misfits(outcome: Outcome, what: str) -> np.ndarray:
    """(n, 3) mg or sd_mg of the one sensor."""
    (sensor,) = outcome.content["sensors"]
    return np.array([m[what] for m in sensor["misfits"]]).reshape(-1, 3)


def _scatters_more(variance: np.ndarray) -> Check:
    """The stated variance of each misfit grows by that (mg²); what was misread stays."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        np.testing.assert_allclose(_misfits(done, "mg"), _misfits(without, "mg"), rtol=1e-9)
        grown = _misfits(done, "sd_mg") ** 2 - _misfits(without, "sd_mg") ** 2
        np.testing.assert_allclose(grown, variance, rtol=0.05, atol=0.01)

    return check


def _turned() -> np.ndarray:
    """(18, 3) mg²: gravity turned by 0.05 deg about each axis, along each of them."""
    table = rows()
    u = direction(table[:, 0], table[:, 1])
    return (1000.0 * np.radians(0.05)) ** 2 * (1.0 - u**2)


def _lighter(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Readings of a place with less gravity: nothing changed, which is 5.8 mg/g of scale at the
    gravity of the calibration."""
    assert (without.content["verdict"], done.content["verdict"]) == ("changed", "still good")
    (before,) = without.content["sensors"]
    scale = next(c for c in before["changes"] if c["kind"] == "scale")
    np.testing.assert_allclose(scale["estimate"], 1000.0 * (9.75 / 9.80665 - 1.0), atol=0.3)
    at_home = bench.run(PLAIN)
    np.testing.assert_allclose(_misfits(done, "mg"), _misfits(at_home, "mg"), atol=0.02)


def _long_ones(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Every other position was held for 4 s: those stay, as they were."""
    one, two = ({m["reading"]: m["mg"] for m in o.content["sensors"][0]["misfits"]}
                for o in (without, done))  # fmt: skip
    assert [len(one), len(two)] == [18, 9]
    assert list(two) == list(one)[1::2]
    np.testing.assert_allclose([two[k] for k in two], [one[k] for k in two], rtol=1e-6)


def _knows(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The table's 15 mg are the effect's, and the calibration has it: nothing is changed."""
    assert without.code == 3
    assert "xy_into_z" in without.stderr
    assert done.content["verdict"] == "still good", done.stderr
    ignorant = bench.run(_on("crossed.csv"))
    assert ignorant.content["verdict"] == "changed"


def _row(outcome: Outcome, name: str) -> Any:
    return next(p for p in outcome.content["parameters"] if p["name"] == name)


def _compared(without: Outcome, done: Outcome, bench: Bench) -> None:
    """One sensor with the cross-talk k, one without: z off by k x y turns gravity by k / 2 at the
    most (x = y) and changes its size by k x y z, k / √27 at the most."""
    assert without.code == 3
    assert "xy_into_z" in without.stderr
    found = _row(done, "xy_into_z")
    (one, two), (sd, other_sd) = found["value"], found["sd"]
    assert abs(two - one - CROSS) < 4.0 * np.hypot(sd, other_sd)
    assert done.content["verdict"] == "differ"
    worst = {w["unit"]: w["difference"] for w in done.content["worst"]}
    assert worst["mg"] == pytest.approx(CROSS / np.sqrt(27.0), rel=0.1)
    assert worst["deg"] == pytest.approx(np.degrees(CROSS / 2000.0), rel=0.1)


def _more_apart(variance: dict[str, float]) -> Check:
    """The variance of each parameter of every calibration grows by that, in its unit."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        for before, after in zip(without.content["parameters"], done.content["parameters"],
                                 strict=True):  # fmt: skip
            kind = before["name"].rpartition("_")[0]
            grown = np.square(after["sd"]) - np.square(before["sd"])
            np.testing.assert_allclose(grown, variance.get(kind, 0.0), rtol=1e-3, atol=1e-9)

    return check


#: Two calibrations that hold the same.
TWINS = ("compare", "<calibration.yaml>", "<calibration.yaml>", "--json")

CASES: tuple[Case, ...] = (
    CHECK("--columns inclination=alpha,tool_face=beta", gives_what(*PLAIN), *_on("renamed.csv")),
    CHECK("--between-sessions 0.5mg", _scatters_more(np.full((18, 3), 0.25))),
    CHECK("--between-sessions 0.05deg", _scatters_more(_turned())),
    CHECK("--between-sessions 0.5mm", ends(2, "no size")),
    CHECK("--gravity 9.75", _lighter, *_on("lighter.csv")),
    CHECK("--latitude 46.3", gives_what(*PLAIN, "--gravity", repr(normal_gravity(46.3, 0.0)))),
    CHECK("--height 1000", gives_what(*PLAIN, "--gravity", repr(normal_gravity(46.3, 1000.0))),
          *PLAIN, "--latitude", "46.3"),
    CHECK("--shortest-rest 3", _long_ones, *_on("long_and_short.csv")),
    CHECK("--shortest-rest 100", ends(3, "18 too short"), *_on("rests.csv")),
    CHECK("--shortest-rest nan", ends(2, "--shortest-rest nan"), *_on("rests.csv")),
    CHECK("--effects <own.py>", _knows, *_on("crossed.csv", "crossed_calibration.yaml")),
    Of("compare")("--between-sessions 0.5mg", _more_apart({"bias": 0.25}), *TWINS),
    Of("compare")("--between-sessions 0.05deg", _more_apart({"mounting": 0.0025}), *TWINS),
    Of("compare")("--effects <own.py>", _compared, "compare", "<own_calibration.yaml>",
                  "<crossed_calibration.yaml>", "--json"),
)  # fmt: skip
