"""Cases of `imucal array` alone."""

from __future__ import annotations

import h5py
import numpy as np

from options.bench import Bench
from options.case import USUAL, Case, Check, Of, both, ends, writes
from options.cases.calibrating_block import searching
from options.outcome import Outcome

ARRAY = Of("array")
PLAIN = USUAL["array"]
#: Of a log whose motion leaves its accelerometers more than their noise.
LOOSE = tuple("<loose_log.h5>" if word == "<log.h5>" else word for word in PLAIN)


def _mm(outcome: Outcome) -> np.ndarray:
    """(3, 3) places of the IMUs beyond the first."""
    return np.array([p["mean"] for p in outcome.content["positions_mm"][1:]])


def _sd(outcome: Outcome) -> np.ndarray:
    return np.array([p["sd"] for p in outcome.content["positions_mm"][1:]])


def _alike(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Another estimate of the same places: other numbers, within three standard deviations."""
    assert done.code in (0, 5), done.stderr
    assert (np.abs(_mm(done) - _mm(without)) < 3.0 * np.hypot(_sd(done), _sd(without))).all()


def _off_the_drawing(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert without.code == 4
    told = [note for note in done.content["notes"] if "off its drawing" in note]
    assert {note.split()[0] for note in told} == {"imu1", "imu2"}


def _draws_to_reach(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The chains go on until every coordinate has as many."""
    found = [o.content["diagnostics"]["smallest_bulk_ess"] for o in (without, done)]
    assert found[0] < 2000.0 <= found[1]


def _draws(outcome: Outcome) -> np.ndarray:
    """(chains, draws, 4, 3) mm of the posterior."""
    with h5py.File(outcome.folder / "draws.h5") as file:
        return np.asarray(file["posterior/position_mm"][()])


def _apart(outcome: Outcome) -> float:
    """mm from imu0 to imu1."""
    found = outcome.content["distances_mm"]
    (one,) = [d["distance"] for d in found if (d["from"], d["to"]) == ("imu0", "imu1")]
    return float(one)


def _longer(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The size is that of the measured distance, imu0 to imu1."""
    drawn = np.hypot(18.0, 2.0)
    lengths = [_apart(o) for o in (without, done)]
    assert abs(lengths[1] - 1.05 * drawn) < 0.1 < abs(lengths[0] - 1.05 * drawn)


def _accepted(unit: str, value: float) -> Check:
    """What may stay unexplained, and nothing else."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        (one,) = [x for x in done.content["left"] if x["unit"] == unit and x["accepted"] == value]
        assert one["beyond"] == (one["value"] > value)

    return check


def _kept_draws(without: Outcome, done: Outcome, bench: Bench) -> None:
    writes("draws.h5")(without, done, bench)
    np.testing.assert_allclose(_draws(done).mean(axis=(0, 1))[1:], _mm(done), rtol=0.02, atol=0.01)


FEW = ("--iterations", "300")
CASES: tuple[Case, ...] = (
    # A drawing that is right to a micrometre leaves the log nothing to say.
    ARRAY("--board <tight.yaml>", ends(4, "of their prior uncertainty")),
    # The log says that two IMUs are exchanged: exit 4; kept so, they are told to be off.
    ARRAY(
        "--as-drawn",
        _off_the_drawing,
        *(a.replace("board.yaml", "exchanged.yaml") for a in PLAIN),
    ),
    ARRAY("--as-published", ends(6, "Algorithm 1 do not agree after 300"), *PLAIN, *FEW),
    ARRAY(
        "--iterations 200",
        ends(6, "Algorithm 1 do not agree after 200"),
        *PLAIN,
        "--as-published",
        *FEW,
    ),
    ARRAY("--samples 60", _alike),
    ARRAY("--ess 2000", _draws_to_reach),
    Case(
        "array",
        "--distance",
        ("--distance", "imu0", "imu1", f"{1.05 * np.hypot(18.0, 2.0):.4f}±0.01mm"),
        _longer,
    ),
    ARRAY("--accept-mm 0.7", _accepted("mm", 0.7), *searching("array")),
    ARRAY("--accept-mg 1", both(_accepted("mg", 1.0), ends(5)), *LOOSE),
    ARRAY("--accept-dps 1e-6", both(_accepted("deg/s", 1e-6), ends(5))),
    ARRAY("--save-draws <out>/draws.h5", _kept_draws),
    ARRAY("--shortest-rest 100", ends(4, "12 too short")),
    ARRAY("--shortest-rest nan", ends(2)),
)
