"""Cases of `imucal actigraph` alone."""

from __future__ import annotations

import numpy as np

from options.bench import Bench
from options.case import USUAL, Case, Of, as_its_kind, ends, values
from options.outcome import Outcome

WORN = Of("actigraph")
PLAIN = USUAL["actigraph"]
PUBLISHED = (*PLAIN, "--as-published")


def _other_sensor(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The second accelerometer is the first with x 3 % longer."""
    assert without.code == 2
    one, two = values(bench.run(PLAIN)), values(done)
    assert np.isclose(1.0 + two["scale_x"], 1.03 * (1.0 + one["scale_x"]), rtol=1e-4)
    assert np.isclose(two["scale_y"], one["scale_y"], atol=1e-4)


def _in_parts(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Parts of 80 minutes beside the whole, which stays as it was."""
    parts = done.content["series"]["parts"]
    assert [(p["start_s"], p["stop_s"]) for p in parts[:2]] == [(0.0, 4800.0), (4800.0, 9600.0)]
    assert without.content.get("series") is None
    for name, value in values(without).items():
        assert np.isclose(values(done)[name], value, rtol=1e-6)


def _published(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Paper 005's own: gradient descent on points of the sphere, and no search."""
    assert done.content["loop"]["verdict"] == "not run"
    scale = np.diag(done.content["matrices"]["corrected_from_raw"]["M"])
    np.testing.assert_allclose(
        scale, np.diag(without.content["matrices"]["corrected_from_raw"]["M"]), atol=5e-3
    )


def _coarse(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Steps of int16 are coarser than those of floating point: multiples of 2^-13."""
    scale = np.diag(done.content["matrices"]["corrected_from_raw"]["M"])
    assert np.isclose(scale * 2.0**13 % 1.0, [0.0], atol=1e-6).all()


CASES: tuple[Case, ...] = (
    WORN("--sensor other", _other_sensor, "actigraph", "<worn_twice.h5>", "--no-loop", "--json"),
    WORN("--every 80min", _in_parts),
    WORN("--every 0h", ends(2, "is not a time")),
    WORN("--fleet <worn_kind.yaml>", as_its_kind(25.0)),
    WORN("--as-published", _published),
    WORN("--arithmetic int16", _coarse, *PUBLISHED),
)
