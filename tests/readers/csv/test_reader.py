"""Text tables: the right numbers or a clear error, in every dialect."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imucalib import readers, writers
from imucalib.errors import UnreadableInput
from imucalib.readers.fields.joining import join
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording
from imucalib.units import STANDARD_GRAVITY
from worlds.recordings import recording_of

G = STANDARD_GRAVITY


def at_rest(n: int, seed: int = 0) -> np.ndarray:
    """(n, 3) in g, gravity on z, rounded to 4 decimals as loggers do."""
    rng = np.random.default_rng(seed)
    return np.round(np.array([0.1, -0.2, 0.97]) + rng.normal(scale=0.003, size=(n, 3)), 4)


def put(folder: Path, text: str, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path


def acc_of(recording: Recording, triad: str = "imu0") -> np.ndarray:
    return recording.channels[f"{triad}/acceleration"].values


def rows(values: np.ndarray, delimiter: str = ",", decimal: str = ".") -> list[str]:
    return [delimiter.join(f"{v:.4f}".replace(".", decimal) for v in row) for row in values]


def test_actigraph_raw(tmp_path: Path) -> None:
    head = [
        "------------ Data File Created By ActiGraph GT3X+ ActiLife v6.13.3 Firmware v1.7.2 "
        "date format M/d/yyyy at 50 Hz  Filter Normal -----------",
        "Serial Number: X", "Start Time 18:40:00", "Start Date 9/17/2019",
        "Epoch Period (hh:mm:ss) 00:00:00", "Download Time 19:20:05", "Download Date 9/17/2019",
        "Current Memory Address: 0", "Current Battery Voltage: 4.18     Mode = 12",
        "--------------------------------------------------",
        "Accelerometer X,Accelerometer Y,Accelerometer Z",
    ]  # fmt: skip
    values = at_rest(400)
    values[100:150] = 0.0  # idle sleep
    for header in (head, head[:-1]):
        path = put(tmp_path, "\r\n".join([*header, *rows(values)]) + "\r\n")
        found = readers.read(path)
        channel = found.channels["imu0/acceleration"]
        keep = np.r_[0:100, 150:400]
        np.testing.assert_allclose(channel.values, values[keep] * G, rtol=1e-14)
        np.testing.assert_array_equal(channel.t, keep / 50.0)
        assert channel.rate == 50.0
        assert [(g.start, g.stop) for g in found.gaps] == [(99 / 50, 150 / 50)]
        assert found.start_ns == 1_568_745_600_000_000_000
        assert any("50 rows of zeros" in n for n in found.notes)
        for size in (1, 60, 130):
            parts = join(readers.blocks(path, block_samples=size), "")
            assert [(g.start, g.stop) for g in parts.gaps] == [(99 / 50, 150 / 50)]
            np.testing.assert_array_equal(parts.channels["imu0/acceleration"].t, channel.t)


def test_missing_values_become_gaps_and_are_never_filled(tmp_path: Path) -> None:
    values = at_rest(200)
    lines = rows(values)
    lines[50], lines[51], lines[120], lines[121] = ",,", "NaN,NaN,NaN", "", "0.1,,0.2"
    path = put(tmp_path, "\n".join(["x,y,z", *lines]) + "\n")
    found = readers.read(path, FieldMapping(rate=100))
    keep = np.setdiff1d(np.arange(200), [50, 51, 120, 121])
    np.testing.assert_allclose(acc_of(found), values[keep] * G, rtol=1e-14)
    np.testing.assert_array_equal(found.channels["imu0/acceleration"].t, keep / 100)
    assert [(g.start, g.stop) for g in found.gaps] == [(0.49, 0.52), (1.19, 1.22)]


STAMPED = [f"{0.01 * k:.2f}," for k in range(500)]
DATED = [f"2024-03-01 12:00:{0.01 * k:06.3f}," for k in range(500)]


@pytest.mark.parametrize("stamps", [[""] * 500, STAMPED, DATED], ids=["no time", "time", "dates"])
@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ("0.1,0.x2,0.3", "'0.x2' is not a number"),
        ("0.1,0.2", "cells where the other rows have"),
        ("0.1,0.2,0.3,0.4,", "cells where the other rows have"),
        ("\xff\x01,0,0", "is not a number"),
    ],
)
@pytest.mark.parametrize("at", [0, 499])
def test_a_bad_row_costs_that_row(
    stamps: list[str], bad: str, words: str, at: int, tmp_path: Path
) -> None:
    values = at_rest(500)
    lines = [a + b for a, b in zip(stamps, rows(values), strict=True)]
    lines[at] = stamps[at] + bad
    head = "time [s],x,y,z" if stamps is STAMPED else "time,x,y,z" if stamps is DATED else "x,y,z"
    path = put(tmp_path, "\n".join([head, *lines]) + "\n")
    mapping = FieldMapping() if stamps[0] else FieldMapping(rate=100)
    found = readers.read(path, mapping)
    keep = np.delete(np.arange(500), at)
    np.testing.assert_allclose(acc_of(found), values[keep] * G, rtol=1e-14)
    t = found.channels["imu0/acceleration"].t
    np.testing.assert_allclose(t - t[0], (keep - keep[0]) / 100, atol=1e-9)
    (told,) = [note for note in found.notes if "left out" in note]
    assert told.startswith(f"1 rows left out; line {at + 2}")
    assert words in told
    with pytest.raises(UnreadableInput, match=f"line {at + 2}"):
        readers.read(path, mapping, strict=True)
    parts = list(readers.blocks(path, mapping, block_samples=50))
    assert sum(p.channels["imu0/acceleration"].t.size for p in parts if p.channels) == 499


def test_time_gaps_back_steps_and_duplicates(tmp_path: Path) -> None:
    t = np.arange(400) * 10
    t[200:] += 500
    t[300:] -= 1000
    t[50] = t[49]
    lines = [f"{a},{r}" for a, r in zip(t, rows(at_rest(400)), strict=True)]
    found = readers.read(put(tmp_path, "\n".join(["time_ms,x,y,z", *lines]) + "\n"))
    assert found.channels["imu0/acceleration"].t.size == 400
    reasons = [g.reason for g in found.gaps if abs(g.stop - g.start - 0.02) > 1e-9]
    assert reasons == ["no samples", "time steps back"]


@pytest.mark.parametrize("packed", [False, True])
def test_gzip_and_utf16_and_bom(packed: bool, tmp_path: Path) -> None:
    text = "\n".join(["t [s],x,y,z", *(f"{k / 100},{r}" for k, r in enumerate(rows(at_rest(300))))])
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        data = (text + "\n").encode(encoding)
        path = tmp_path / ("a.csv.gz" if packed else "a.csv")
        path.write_bytes(gzip.compress(data) if packed else data)
        np.testing.assert_allclose(acc_of(readers.read(path)), at_rest(300) * G, rtol=1e-14)


def test_cut_gzip_gives_what_is_readable(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = np.round(at_rest(20000) + rng.normal(scale=0.01, size=(20000, 3)), 4)
    data = gzip.compress(("\n".join(["x,y,z", *rows(values)]) + "\n").encode())
    path = tmp_path / "a.csv.gz"
    path.write_bytes(data[: len(data) // 2])
    found = readers.read(path, FieldMapping(rate=100))
    n = acc_of(found).shape[0]
    assert n > 5000
    np.testing.assert_allclose(acc_of(found), values[:n] * G, rtol=1e-14)
    assert any("breaks off" in note for note in found.notes)
    with pytest.raises(UnreadableInput):
        readers.read(path, FieldMapping(rate=100), strict=True)


@pytest.mark.parametrize("before", ["", "0.1,-0.2,0.9"])
@pytest.mark.parametrize("zeros", [4096, 3 << 20])
@pytest.mark.parametrize("block", [100, 1 << 18])
def test_zero_bytes_complete_no_cut_line(
    before: str, zeros: int, block: int, tmp_path: Path
) -> None:
    """before : of a line that zero bytes follow; some loggers go on behind them"""
    whole, hole = at_rest(400), "\0" * zeros
    text = "\n".join(["x,y,z", *rows(whole)]) + "\n" + before + hole
    mapping = FieldMapping(rate=100)
    for after, notes in (
        ("", ("line 402 has no line end",) if before else (f"{zeros} zero bytes",)),
        ("7,8\n" + "\n".join(rows(whole)) + "\n", ("1 rows left out; line 402",)),
    ):
        path = put(tmp_path, text + after)
        found = join(readers.blocks(path, mapping, block_samples=block), "")
        wanted = np.concatenate([whole] * (2 if after else 1)) * G
        np.testing.assert_allclose(acc_of(found), wanted, rtol=1e-14)
        for note in notes:
            assert any(note in n for n in found.notes), found.notes


DELIMITERS = st.sampled_from([",", ";", "\t", " ", "|"])


@st.composite
def dialects(draw: st.DrawFn) -> tuple[str, np.ndarray, np.ndarray]:
    """A text table in a random dialect, its times (s) and accelerations (g)."""
    delimiter = draw(DELIMITERS)
    decimal = "." if delimiter == "," else draw(st.sampled_from([".", ","]))
    n = draw(st.integers(12, 80))
    digits = draw(st.integers(2, 6))
    values = at_rest(n, draw(st.integers(0, 9)))
    values = np.round(values + np.arange(n)[:, None] * 1e-4, digits)
    step = draw(st.sampled_from([5, 10, 20]))
    unit, per = draw(st.sampled_from([("ms", 1), ("us", 1000), ("ns", 1_000_000)]))
    start = draw(st.sampled_from([0, 37, 1_600_000_000_000]))
    names = draw(
        st.sampled_from(
            ["t;ax;ay;az", "time;acc_x;acc_y;acc_z", "Time;Accel X;Accel Y;Accel Z", "stamp;x;y;z"]
        )
    ).split(";")
    if delimiter == " ":
        names = [name.replace(" ", "_") for name in names]
    bracket = draw(st.booleans()) and delimiter != " "
    names[0] += f" [{unit}]" if bracket else f"_{unit}"
    order = draw(st.permutations(range(5)))
    junk = draw(st.sampled_from(["7", "0.5".replace(".", decimal), "-12"]))
    names.append("junk")
    body = []
    for k in range(n):
        cells = [str((start + step * k) * per)]
        cells += [f"{v:.{digits}f}".replace(".", decimal) for v in values[k]]
        cells.append(junk)
        body.append(delimiter.join(cells[i] for i in order))
    quote = draw(st.booleans()) and delimiter != " "
    header = delimiter.join(f'"{names[i]}"' if quote else names[i] for i in order)
    tail = delimiter if draw(st.booleans()) and delimiter != " " else ""
    above = draw(st.lists(st.sampled_from(["# a logger", "Serial: 12", "", "// note"]), max_size=4))
    end = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    lines = [*above, draw(st.sampled_from(["", "# "])) + header + tail, *(b + tail for b in body)]
    return end.join(lines) + end, step * np.arange(n) / 1000, values


@pytest.mark.slow
@given(table=dialects())
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_dialect_gives_the_right_numbers(
    table: tuple[str, np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    text, t, values = table
    found = readers.read(put(tmp_path, text))
    np.testing.assert_allclose(acc_of(found), values * G, rtol=1e-13)
    read_t = found.channels["imu0/acceleration"].t
    np.testing.assert_allclose(read_t - read_t[0], t, atol=1e-9)


def test_our_own_table_is_held_against_its_sum(tmp_path: Path) -> None:
    t = np.arange(300) / 100.0
    path = tmp_path / "a.csv"
    writers.write(recording_of(t, at_rest(300) * G, hz=100.0, start_ns=10**18), path)
    data = path.read_bytes()
    at = data.rindex(b".") + 1
    other = b"1" if data[at : at + 1] == b"2" else b"2"
    digit = data[:at] + other + data[at + 1 :]
    day = data.replace(b"start_ns: 1000", b"start_ns: 1001")
    for changed in (digit, day):
        path.write_bytes(changed)
        assert any("CRC-32" in note for note in readers.read(path).notes)
        assert any("CRC-32" in note for note in [*readers.blocks(path, block_samples=50)][-1].notes)
        with pytest.raises(UnreadableInput, match="CRC-32"):
            readers.read(path, strict=True)
    first, _, below = data.partition(b"\n")
    old = first[: first.index(b", crc32")] + b"\n" + below
    for fine in (data, data.replace(b"\n", b"\r\n"), gzip.compress(data), old):
        path.write_bytes(fine)
        assert readers.read(path, strict=True).notes == ()


ODD = (
    "", "nan", "NaN", "inf", "-Infinity", "1e400", "4.9e-324", "+4", ".5", "5.", " 3", "3 ", "-0",
    "0x10", "1_0", "1d3", "NA", "null", "1,5", "1\0", "--1", "-", "1e", "true", "\u0661", "007",
    "9007199254740993", "9223372036854775808", "1.7976931348623159e308", "\t7", "#", "'1'", "1.0",
    "2.2250738585072011e-308", "2024-01-02 03:04:05.678",
)  # fmt: skip


@pytest.mark.parametrize("cell", ODD)
def test_an_odd_cell_is_its_number_or_none(cell: str, tmp_path: Path) -> None:
    lines = rows(at_rest(600))
    lines[20] = f"0.1,{cell},0.9"
    path = put(tmp_path, "\n".join(["x [g],y [g],z [g]", *lines]) + "\n")
    found = acc_of(readers.read(path, FieldMapping(rate=100)))
    plain = re.fullmatch(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", cell)
    if plain is None or not abs(float(cell)) < 1000.0:  # g: more reads no sensor
        assert found.shape == (599, 3)
        np.testing.assert_allclose(found, np.delete(at_rest(600), 20, axis=0) * G, rtol=1e-14)
    else:
        np.testing.assert_allclose(found[20], np.array([0.1, float(cell), 0.9]) * G, rtol=1e-14)


def test_coarse_stamps_are_spread_and_said(tmp_path: Path) -> None:
    values = at_rest(30 * 40)
    lines = [f"2020-01-01 00:00:{k // 30:02d},{r}" for k, r in enumerate(rows(values)) if k >= 12]
    found = readers.read(put(tmp_path, "\n".join(["time,x,y,z", *lines]) + "\n"))
    channel = found.channels["imu0/acceleration"]
    assert channel.rate == pytest.approx(30.0)
    np.testing.assert_allclose(channel.t, np.arange(12, 1200) / 30, atol=1e-9)
    assert any("resolution of 1 s" in n for n in found.notes)
    assert found.gaps == ()
