"""A clock in any form is the clock of the plain file, or is refused with the way out."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.errors import ImucalError, UnreadableInput
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.recording.recording import Recording

START = 1_700_000_000_000_000_000
WHEN = datetime(2023, 11, 14, 22, 13, 20, tzinfo=UTC)
RATE, ROWS = 50.0, 900
Stamp = Callable[[int], str]


def moment(k: int, hours: int = 0) -> datetime:
    return WHEN + timedelta(milliseconds=20 * k, hours=hours)


def ns(k: int) -> int:
    return START + 20_000_000 * k


def days(zero: float, digits: int) -> Stamp:
    return lambda k: f"{(ns(k) / 1e9 / 86_400 + zero):.{digits}f}"


def clock(form: str, hours: int = 0) -> Stamp:
    """strftime with %L for milliseconds and %P for "p.m."."""

    def stamp(k: int) -> str:
        when = moment(k, hours)
        text = form.replace("%L", f"{when.microsecond // 1000:03d}")
        text = text.replace("%P", "p.m." if when.hour > 11 else "a.m.")
        return when.strftime(text)

    return stamp


#: heading -> stamps that say when; what their digits leave open, s
DATED: dict[str, tuple[str, Stamp, float]] = {
    "iso": ("time", clock("%Y-%m-%d %H:%M:%S.%L"), 0.0),
    "iso with T and Z": ("time", clock("%Y-%m-%dT%H:%M:%S.%LZ"), 0.0),
    "offset": ("time", clock("%Y-%m-%d %H:%M:%S.%L+02:00", 2), 0.0),
    "offset of hours": ("time", clock("%Y-%m-%d %H:%M:%S.%L-05", -5), 0.0),
    "offset of GMT": ("time", clock("%Y-%m-%d %H:%M:%S.%L GMT+2", 2), 0.0),
    "named zone": ("time", clock("%Y-%m-%d %H:%M:%S.%L CET", 1), 0.0),
    "PM": ("time", clock("%m/%d/%Y %I:%M:%S.%L %p"), 0.0),
    "p.m.": ("time", clock("%m/%d/%Y %I:%M:%S.%L %P"), 0.0),
    "PM and zone": ("time", clock("%m/%d/%Y %I:%M:%S.%L %p EST", -5), 0.0),
    "day first": ("time", clock("%d.%m.%Y %H:%M:%S.%L"), 0.0),
    "month by name": ("time", clock("%d-%b-%Y %H:%M:%S.%L"), 0.0),
    "month by name first": ("time", clock("%B %d %Y %I:%M:%S.%L %p"), 0.0),
    "compact": ("time", clock("%Y%m%dT%H%M%S.%L"), 0.0),
    "seconds": ("time (s)", lambda k: f"{ns(k) / 1e9:.3f}", 1e-6),
    "unix": ("Timestamp (unix)", lambda k: str(ns(k) // 10**6), 0.0),
    "us": ("timestamp", lambda k: str(ns(k) // 1000), 0.0),
    "spreadsheet": ("time", days(25_569, 10), 1e-5),
    "MATLAB": ("time", days(719_529, 10), 2e-5),
    "Julian": ("time", days(2_440_587.5, 9), 1e-4),
    "FILETIME": ("time", lambda k: str((ns(k) // 100) + 116_444_736_000_000_000), 0.0),
    ".NET ticks": ("time", lambda k: str((ns(k) // 100) + 621_355_968_000_000_000), 0.0),
    "days since": ("time [days since 2023-11-14]", days(-19_675.0, 10), 1e-5),
    "Date and Time": ("Date,Time", clock("%d/%m/%Y,%H:%M:%S.%L"), 0.0),
    "parts": ("Year,Month,Day,Hour,Minute,Second", clock("%Y,%m,%d,%H,%M,%S.%L"), 0.0),
    "parts with ms": ("year,month,day,hour,minute,second,ms",
                      lambda k: moment(k).strftime("%Y,%m,%d,%H,%M,%S,") +
                      str(moment(k).microsecond // 1000), 0.0),
}  # fmt: skip
#: The same without a date.
BARE: dict[str, tuple[str, Stamp, float]] = {
    "minutes": ("time (min)", lambda k: f"{k / RATE / 60:.9f}", 1e-7),
    "minutes by name": ("elapsed_min", lambda k: f"{k / RATE / 60:.9f}", 1e-7),
    "hours": ("time [h]", lambda k: f"{k / RATE / 3600:.10f}", 1e-6),
    "days": ("time (days)", lambda k: f"{k / RATE / 86_400:.12f}", 1e-6),
    "milliseconds": ("time (milliseconds)", lambda k: str(20 * k), 0.0),
    "minutes and seconds": ("time",
                            lambda k: f"{(3590 + k / RATE) % 3600 // 60:02.0f}:"
                            f"{(3590 + k / RATE) % 60:05.2f}", 1e-9),
    "time of day": ("time", clock("%H:%M:%S.%L", 1), 1e-9),
    "past midnight": ("time",
                      lambda k: (moment(k) + timedelta(seconds=6390)).strftime("%H:%M:%S.%f"),
                      1e-9),
}  # fmt: skip


def values() -> np.ndarray:
    rng = np.random.default_rng(4)
    return np.round(np.array([0.1, -0.2, 0.97]) + rng.normal(scale=0.004, size=(ROWS, 3)), 4)


def table(path: Path, heading: str, stamp: Stamp, above: str = "") -> Path:
    lines = [f"{stamp(k)},{x},{y},{z}" for k, (x, y, z) in enumerate(values().tolist())]
    path.write_text(f"{above}{heading},acc_x (g),acc_y (g),acc_z (g)\n" + "\n".join(lines) + "\n")
    return path


def same_moments(found: Recording, slack: float, start: int | None) -> None:
    channel = found.channels["imu0/acceleration"]
    np.testing.assert_allclose(channel.t - channel.t[0], np.arange(ROWS) / RATE, atol=slack + 1e-9)
    assert channel.rate == pytest.approx(RATE, rel=slack * RATE + 1e-4)
    assert not found.gaps
    if start is not None:
        assert found.start_ns == pytest.approx(start, abs=slack * 1e9)


@pytest.mark.parametrize("form", DATED)
def test_every_dated_clock_gives_the_same_moments(form: str, tmp_path: Path) -> None:
    heading, stamp, slack = DATED[form]
    path = table(tmp_path / "a.csv", heading, stamp)
    found = readers.read(path)
    same_moments(found, slack, START)
    same_moments(readers.read(path, from_dict(found.mapping)), slack, START)


@pytest.mark.parametrize("form", BARE)
def test_every_clock_without_a_date_gives_the_same_steps(form: str, tmp_path: Path) -> None:
    heading, stamp, slack = BARE[form]
    path = table(tmp_path / "a.csv", heading, stamp)
    same_moments(readers.read(path), slack, None)
    parts = list(readers.blocks(path, block_samples=100))
    t = np.concatenate([p.channels["imu0/acceleration"].t for p in parts])
    np.testing.assert_allclose(t - t[0], np.arange(ROWS) / RATE, atol=slack + 1e-9)


@pytest.mark.parametrize(
    ("heading", "stamp", "words"),
    [
        ("time (fortnights)", lambda k: f"{k / RATE:.2f}", "'fortnights'.*--time-unit"),
        ("time [days since the flood]", lambda k: f"{k / RATE:.2f}", "no date.*--time-unit"),
        ("time", clock("%Y-%m-%d %H:%M:%S.%L CST"), "'cst'.*--time-format"),
        ("time", clock("%Y-%m-%d %H:%M:%S.%L nonsense"), "'nonsense'"),
        ("time", lambda k: f"{k / RATE / 86_400:.12f}", "--time-unit"),
    ],
)
def test_a_clock_that_is_not_known_is_refused(
    heading: str, stamp: Stamp, words: str, tmp_path: Path
) -> None:
    with pytest.raises(UnreadableInput, match=words):
        readers.read(table(tmp_path / "a.csv", heading, stamp))


#: One stamp of 700 is not like the others.
ODD = ("2023-02-30 12:00:05.000", "2023-02-28 12:00:05.000 PM", "2023-02-28 12:00:05.000 CET",
       "2023-02-28 12:00:05.000Z", "x", "2023-02-28 25:00:05.000", "2023-02-28")  # fmt: skip


@pytest.mark.parametrize("odd", ODD)
def test_a_stamp_unlike_the_others_costs_its_row(odd: str, tmp_path: Path) -> None:
    plain = clock("%Y-%m-%d %H:%M:%S.%L")
    path = table(tmp_path / "a.csv", "time", lambda k: odd if k == 700 else plain(k))
    found = readers.read(path)
    assert found.channels["imu0/acceleration"].t.size == ROWS - 1
    assert any("line 702: the time stamp" in note for note in found.notes)


def test_a_format_passes_over_the_letters_that_it_names(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", "time", clock("%Y-%m-%d %H:%M:%S.%L CST"))
    same_moments(readers.read(path, FieldMapping(time_format="%Y-%m-%d %H:%M:%S.%f CST")), 0, START)
    with pytest.raises(ImucalError, match="%Q of the time format"):
        readers.read(path, FieldMapping(time_format="%Q"))
