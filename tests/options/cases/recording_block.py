"""Options that say how a recording is read, shown on `convert`: the rows that come out.

`test_shared` shows that the other commands hand them to the same reader.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.readers import read
from options.bench import Bench
from options.case import Case, Check, Of, ends
from options.outcome import Outcome
from options.recordings import G, samples

CONVERT = Of("convert")
TO = "<out>/samples.csv"
ACC, RATE, WARM = slice(1, 4), slice(4, 7), slice(7, 8)
QUANTITY = {"acceleration": ACC, "angular_rate": RATE, "temperature": WARM}


def _read(done: Outcome) -> dict[str, Array]:
    """Quantity -> (n, k + 1) t s and values, as the written file says."""
    assert done.code == 0, done.stderr
    found = read(done.folder / "samples.csv")
    return {c.quantity: np.column_stack([c.t, c.values]) for c in found.channels.values()}


def holds(change: Callable[[Array], Array], *quantities: str) -> Check:
    """What was written is `samples` after a change; all quantities, or those named."""

    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        table = change(samples())
        found = _read(done)
        assert set(found) == set(quantities or QUANTITY)
        for name, rows in found.items():
            np.testing.assert_allclose(rows[:, 0], table[:, 0] - table[0, 0], atol=1e-6)
            np.testing.assert_allclose(rows[:, 1:], table[:, QUANTITY[name]], rtol=1e-7, atol=1e-9)

    return check


def _scaled(columns: slice, by: float, less: float = 0.0) -> Callable[[Array], Array]:
    def change(table: Array) -> Array:
        table[:, columns] = (table[:, columns] - less) * by
        return table

    return change


def _as_they_are(table: Array) -> Array:
    return table


def _turned(table: Array) -> Array:
    table[:, 1:4] = np.column_stack([table[:, 2], -table[:, 1], table[:, 3]])
    table[:, 4:7] = np.column_stack([table[:, 5], -table[:, 4], table[:, 6]])
    return table


def _about_x(table: Array) -> Array:
    table[:, 1:4] = np.column_stack([table[:, 1], table[:, 3], -table[:, 2]])
    return table


def _at_50_hz(table: Array) -> Array:
    table[:, 0] = np.arange(len(table)) / 50.0
    return table


def _on(name: str, *more: str) -> tuple[str, ...]:
    return ("convert", f"<{name}>", TO, *more)


BARE = _on("bare.csv", "--unit", "m/s2", "--gyro-unit", "rad/s")
CASES: tuple[Case, ...] = (
    CONVERT("--mapping <counts.yaml>", holds(_scaled(ACC, 1.0, 3.0 / 256.0 * -G)),
            *_on("counts.csv")),
    CONVERT("--acc bx,by,bz", holds(_about_x), *_on(
        "other_axes.csv", "--unit", "m/s2", "--gyro-unit", "rad/s")),
    CONVERT("--gyro ax,ay,az", lambda a, b, c: np.testing.assert_allclose(
        _read(b)["angular_rate"][:, 1:], samples()[:, ACC]), *BARE),
    CONVERT("--temperature gx", lambda a, b, c: np.testing.assert_allclose(
        _read(b)["temperature"][:, 1], samples()[:, 4]), *BARE),
    CONVERT("--time temp", lambda a, b, c: np.testing.assert_allclose(
        _read(b)["acceleration"][:, 0], samples()[:, 7]), *BARE, "--time-unit", "s"),
    CONVERT("--unit g", holds(_as_they_are), *_on("in_g.csv", "--gyro-unit", "rad/s")),
    CONVERT("--lsb 256", holds(_scaled(ACC, 1.0, -3.0 * G / 256.0)),
            *_on("counts.csv", "--unit", "counts", "--gyro-unit", "rad/s")),
    CONVERT("--acc-offset 3", holds(_as_they_are),
            *_on("counts.csv", "--unit", "counts", "--lsb", "256", "--gyro-unit", "rad/s")),
    CONVERT("--gyro-unit deg/s", holds(_scaled(RATE, np.pi / 180.0)),
            *_on("bare.csv", "--unit", "m/s2")),
    CONVERT("--gyro-lsb 16.4", holds(_scaled(RATE, np.pi / 180.0 / 16.4)),
            *_on("bare.csv", "--unit", "m/s2", "--gyro-unit", "counts")),
    CONVERT("--time-unit ms", holds(_as_they_are), *_on(
        "stamps_ms.csv", "--unit", "m/s2", "--gyro-unit", "rad/s")),
    CONVERT("--temperature-unit K", holds(_as_they_are), *_on(
        "kelvin.csv", "--unit", "m/s2", "--gyro-unit", "rad/s")),
    Case("convert", "--time-format", ("--time-format", "%m/%d/%Y %H:%M:%S.%f CST"),
         holds(_as_they_are), _on("odd_stamps.csv", "--unit", "m/s2", "--gyro-unit", "rad/s")),
    CONVERT("--where tool=A12", holds(_as_they_are), *_on(
        "two_tools.csv", "--unit", "m/s2", "--gyro-unit", "rad/s")),
    CONVERT("--rate 50", holds(_at_50_hz), *BARE),
    CONVERT("--axis-map y,-x,z", holds(_turned), *BARE),
    CONVERT("--preset euroc", holds(_as_they_are, "acceleration", "angular_rate"),
            *_on("columns.csv")),
    CONVERT("--skip 2", holds(_as_they_are), *_on(
        "titled_log.csv", "--unit", "m/s2", "--gyro-unit", "rad/s")),
    CONVERT("--decimal .", ends(3), *_on("comma_log.csv", "--unit", "m/s2")),
    CONVERT("--delimiter ^", holds(_as_they_are), *_on(
        "piped_log.csv", "--unit", "m/s2", "--gyro-unit", "rad/s")),
    CONVERT("--max-chunk 100", ends(3, "--max-chunk"), *_on("packed.mcap", "--strict")),
    CONVERT("--allow-external", lambda a, b, c: np.testing.assert_allclose(
        _read(b)["acceleration"][:, 1:], samples()[:, ACC]), *_on("external.h5")),
    CONVERT("--strict", ends(3, "line 31"), *_on("damaged.csv")),
)  # fmt: skip
