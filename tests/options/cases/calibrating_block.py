"""Options that every calibrating command has: one case each, of each command."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from typing import Any

import numpy as np

from options.bench import Bench
from options.case import USUAL, Case, Check, Of, ends, longer, says_the_cost, values, writes
from options.outcome import Outcome

#: Search restricted to one effect, on the small input of each command, and what it may search.
SEARCH: dict[str, tuple[str, str]] = {
    "lab": ("cubic", "quadratic"),
    "actigraph": ("asymmetry", "hysteresis"),
    "array": ("gyro_delay", "gyro_scale"),
    "imu": ("gyro_asymmetry", "gyro_quadratic"),
}
RESULTS = ("calibration.yaml", "report.html", "report.json")


def searching(name: str, *more: str) -> tuple[str, ...]:
    """The usual call with a search of two effects, of an array on enough samples for two halves."""
    plain = ["100" if a == "40" else a for a in USUAL[name] if a != "--no-loop"]
    both = [part for effect in SEARCH[name] for part in ("--only", effect)]
    return (*plain, *both, *more)


def normal_gravity(latitude: float, height: float) -> float:
    """m/s², WGS 84: Somigliana's formula and the second-order height term (NIMA TR8350.2, eqs. 4-1
    and 4-3), written a second time."""
    a, f, m = 6378137.0, 1.0 / 298.257223563, 0.00344978650684
    s = np.sin(np.radians(latitude)) ** 2
    g = 9.7803253359 * (1.0 + 0.00193185265241 * s) / np.sqrt(1.0 - 0.00669437999014 * s)
    return float(
        g * (1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * s) * height + 3.0 * (height / a) ** 2)
    )


def _matrix(outcome: Outcome) -> np.ndarray:
    """(3, 3) of the correction: one accelerometer's, or the first IMU's gain inverted."""
    found = outcome.content
    if "matrices" in found:
        return np.array(found["matrices"]["corrected_from_raw"]["M"])
    return np.array(found["triads"][0]["gain"])


def _stronger(g: float) -> Check:
    """Corrected readings grow as gravity does."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        ratio = np.diag(_matrix(done)) / np.diag(_matrix(without))
        power = 1.0 if "matrices" in done.content else -1.0  # of an array, the gain itself
        np.testing.assert_allclose(ratio, (g / 9.80665) ** power, rtol=2e-4)
        stated = done.content["provenance"]["settings"]["gravity_m_per_s2"]
        assert np.isclose(stated, g, rtol=0, atol=1e-6)

    return check


def _named(effect: str) -> Check:
    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        def effects(of: Outcome) -> set[str]:
            shown = {p["effect"] for p in of.content["parameters"]}
            return shown | {e["effect"] for e in of.content.get("effects", ())}

        # A board's joint fit holds the gyros' frame too, which nobody declared.
        new = {e.partition("@")[0] for e in effects(done) - effects(without)}
        assert new - {"gyro_frame"} == {effect}

    return check


def _candidates(outcome: Outcome) -> set[str]:
    loop = outcome.content["loop"]
    names = {c["name"] for c in loop["candidates"]} | {s["effect"] for s in loop["steps"]}
    return {name.partition("@")[0] for name in names}


def _searches(wanted: set[str], missing: set[str]) -> Check:
    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        found = _candidates(done)
        assert wanted <= found
        assert not missing & found
        assert _candidates(without) >= wanted | missing

    return check


def _knows_own(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert without.code == 2
    assert "xy_into_z" in without.stderr
    assert done.code == 0, done.stderr
    assert "xy_into_z" in done.stdout


def _without_only(search: tuple[str, ...]) -> tuple[str, ...]:
    """The whole catalogue."""
    at = search.index("--only")
    return (*search[:at], *search[at + 4 :])


def _as_at(gravity: str) -> Check:
    """The same calibration as with that gravity."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        other = bench.run((*(a for a in USUAL[_name(done)]), "--gravity", gravity))
        np.testing.assert_allclose(_matrix(done), _matrix(other), rtol=1e-7)

    return check


def _name(outcome: Outcome) -> str:
    return str(outcome.content["calibrator"])


def _not_searched(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert without.content["loop"]["verdict"] != "not run"
    loop = done.content["loop"]
    assert (loop["verdict"], loop["steps"], loop["candidates"]) == ("not run", [], [])


def _stored(without: Outcome, done: Outcome, bench: Bench) -> None:
    writes(*RESULTS)(without, done, bench)
    assert json.loads(done.text("report.json")) == done.content
    for name, value in values(done).items():
        assert name in done.text("calibration.yaml"), value


def _exported(without: Outcome, done: Outcome, bench: Bench) -> None:
    (name,) = set(done.files) - set(without.files)
    assert set(without.files) == set(RESULTS)
    printed = bench.run(("export", str(done.folder / "calibration.yaml"), "--to", "c-header"))
    assert done.text(name) == printed.stdout


def _collected(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The entry is a row of a table as one that batch has written."""
    assert done.code == without.code
    assert set(done.files) == {"entry.json", "entry.yaml"}
    table = done.folder / "table.csv"
    typed = ("collect", str(done.folder), "-o", str(table), "--all-columns")
    assert bench.run(typed).code == 0
    with table.open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["status"] == done.content["status"]
    first = done.content["parameters"][0]
    assert float(row[first["name"]]) == first["value"]


def _other_draws(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Another seed moves what is drawn, and nothing else."""
    assert done.content["provenance"]["seed"] == 5
    assert without.content["provenance"]["seed"] == 0


def _curve_corrected(name: str) -> Check:
    """A curve takes what has no name out of the error; without it, it stays."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        plain, curved = (without, done) if name == "array" else (done, without)
        assert len(curved.content["loop"]["steps"]) > len(plain.content["loop"]["steps"]) == 0
        before, after = (
            o.content["loop"]["errors"][0]["held_out"]["final"] for o in (plain, curved)
        )
        assert after < 0.95 * before

    return check


#: Data with structure that has no name, searched for an effect that it is not.
CURVED: dict[str, tuple[str, tuple[str, ...]]] = {
    "lab": ("--no-curves", ("lab", "<curved.csv>", "--reference", "norm", "--only", "bias_drift")),
    "actigraph": ("--no-curves", ("actigraph", "<bent.h5>", "--only", "posture")),
    "imu": ("--no-curves", ("imu", "<bent_turns.csv>", "--only", "bias_drift")),
    "array": ("--curves", ("array", "<loose_log.h5>", "--board", "<board.yaml>", "--samples",
                           "150", "--only", "gyro_delay")),
}  # fmt: skip
#: What a call of each ends with, and exit 0; the call.
GATE = {"lab": "caution", "actigraph": "caution", "array": "unexplained", "imu": "caution"}
CAUTIONED: dict[str, tuple[str, ...]] = {
    "lab": CURVED["lab"][1],
    "actigraph": ("actigraph", "<bent.h5>", "--only", "bias_drift"),
    "array": (*CURVED["array"][1], "--accept-mm", "1"),
    "imu": CURVED["imu"][1],
}


def _limited(name: str, option: str, value: Callable[[Any], float]) -> tuple[Case, ...]:
    """Limits are held against held-out errors; NaN is no limit and no value below one."""
    of, typed = Of(name), searching(name)

    def held_against(without: Outcome, done: Outcome, bench: Bench) -> None:
        (limit,) = done.content["limits"]
        assert np.isclose(limit["value"], value(done.content), rtol=1e-4)
        assert (limit["broken"], done.code) == (False, without.code)

    return (
        of(f"{option} 1e9", held_against, *typed, changes={"limits"}),
        of(f"{option} 1e-9", ends(1), *typed),
        of(f"{option} nan", ends(2, "a limit is zero or more"), *typed),
    )


def _final(k: int) -> Callable[[Any], float]:
    return lambda report: float(report["loop"]["errors"][k]["held_out"]["final"])


def _of_split(block: str, part: int) -> Callable[[Any], float]:
    """Of the last split's final model: block_deg holds (largest, rms), norm_mg (rms?)."""
    return lambda report: float(report["held_out"][-1][block][part])


LIMITS: tuple[tuple[str, str, Callable[[Any], float]], ...] = (
    ("lab", "--max-error", _final(0)),
    ("lab", "--max-inclination-error", _of_split("inclination_deg", 0)),
    ("lab", "--max-toolface-error", _of_split("tool_face_deg", 0)),
    ("lab", "--max-norm-error", _of_split("norm_mg", 1)),
    ("actigraph", "--max-error", _final(0)),
    ("actigraph", "--max-worst-error", lambda report: max(
        abs(v) for f in report["figures"] if f["title"] == "Error of |a| against time"
        for s in f["series"] if s["label"] == "after" for v in s["y"])),
    ("imu", "--max-error", _final(0)),
    ("imu", "--max-force-error", _final(1)),
    ("array", "--max-error", _final(0)),
    ("array", "--max-gyro-error", _final(1)),
    ("array", "--max-position-sd", lambda report: max(
        v for p in report["positions_mm"] for v in p["sd"])),
)  # fmt: skip


def _of(name: str) -> tuple[Case, ...]:
    of, plain, search = Of(name), USUAL[name], searching(name)
    first, second = SEARCH[name]
    words = tuple(a for a in plain if a != "--json")
    high = repr(normal_gravity(46.3, 3000.0))
    curves, bent = CURVED[name]
    return (
        of("--gravity 9.75", _stronger(9.75)),
        of("--latitude 46.3", _stronger(normal_gravity(46.3, 0.0))),
        of("--height 3000", _as_at(high), *plain, "--latitude", "46.3"),
        of("--output <out>", _stored),
        of("--entry <out>/entry.json", _collected, *plain, "--json"),
        of("--export c-header", _exported, *plain, "-o", "<out>"),
        of(f"--declare {first}", _named(first)),
        of(f"--only {second}", _searches({second}, {first}), *_without_only(search)),
        of(f"--without {second}", _searches({first}, {second}), *search),
        of("--effects <own.py>", _knows_own, *plain, "--declare", "xy_into_z"),
        of("--no-loop", _not_searched, *search),
        of(curves, _curve_corrected(name), *bent, "--json"),
        *((of("--seed 5", _other_draws, *search),) if name == "array" else ()),
        of(f"--fail-on {GATE[name]}", ends(5), *CAUTIONED[name], "--json"),
        of("--full", longer, *words),
        of("--verbose", says_the_cost),
    )


CASES: tuple[Case, ...] = (
    *(case for name in SEARCH for case in _of(name)),
    *(case for limit in LIMITS for case in _limited(*limit)),
)
