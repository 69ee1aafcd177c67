"""Loggers' own files and flight logs: packings, clocks, restarts, damage, cost; known by bytes."""

from __future__ import annotations

import gzip
import hashlib
import io
import time
import zipfile
import zlib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.readers import read
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG, STANDARD_GRAVITY
from worlds import flight_logs
from worlds.logger_files import (
    ax_file,
    ax_header,
    ax_sector,
    gene_file,
    gene_page,
    gt3x_record,
    gt3x_second,
    old_gt3x,
    wav_file,
)
from worlds.places import DATA, MEASURED, needs_data

START = datetime(2020, 2, 12, 9, 3, 37, tzinfo=UTC)
SECONDS = round(START.timestamp())
INFO = "Serial Number: X1\nSample Rate: 30\nAcceleration Scale: 256.0\nTimeZone: 02:00:00\n"
OLD_INFO = "Sample Rate: 30\nStart Date: 634556532600000000\n"
GAIN, OFFSET = np.array([25522.0, 25457.0, 24829.0]), np.array([272.0, -1129.0, 101.0])


def counts(n: int, *, one_g: int = 256, axes: int = 3) -> np.ndarray:
    rng = np.random.default_rng(n)
    rest = np.zeros(axes, int)
    rest[-1] = one_g
    return rest + rng.integers(-40, 40, size=(n, axes))


def saved(folder: Path, data: bytes, name: str = "a.log") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def zipped(method: int = zipfile.ZIP_DEFLATED, *, piped: bool = False, **members: bytes) -> bytes:
    """An archive; written to a pipe, sizes and checksums come after the members."""
    out = io.BytesIO()
    out.seekable = lambda: not piped  # type: ignore[method-assign]
    with zipfile.ZipFile(out, "w", method) as file:
        for name, data in members.items():
            file.writestr(name.replace("_", "."), data)
    return out.getvalue()


def gt3x(log: bytes, info: str = INFO, **how: bool) -> bytes:
    return zipped(info_txt=info.encode(), log_bin=log, **how)


def seconds_of(samples: np.ndarray, seconds: list[int], *, kind: int = 26) -> bytes:
    """log.bin of 30 samples a second."""
    parts = zip(seconds, samples.reshape(-1, 30, 3), strict=True)
    rows = [gt3x_second(some, SECONDS + second, kind) for second, some in parts]
    rows.insert(1, gt3x_record(3, SECONDS, b"\x08"))
    return b"".join(rows)


def force(found: Recording) -> Channel:
    return found.channels["imu0/acceleration"]


def in_g(found: Recording) -> np.ndarray:
    return force(found).values / STANDARD_GRAVITY


#: Every format of packets: a log of 3000 samples at some rate, and what it reads in g.
MANY = counts(3000)
FILES = {
    "cwa": (ax_file(MANY.tolist(), START), 100.0, MANY / 256),
    "cwa 16 bits": (ax_file(MANY.tolist(), START, axes=0x32, per_sector=80), 100.0, MANY / 256),
    "geneactiv": (gene_file(MANY.tolist(), START), 50.0, (100 * MANY - OFFSET) / GAIN),
    "gt3x": (gt3x(seconds_of(MANY, list(range(100)))), 30.0, MANY / 256),
    "gt3x 12 bits": (gt3x(seconds_of(MANY, list(range(100)), kind=0)), 30.0, MANY / 256),
    "gt3x activity": (old_gt3x(MANY.tolist(), START), 30.0, MANY / 341),
    "wav": (wav_file(MANY.tolist(), START), 100.0, MANY * 8 / 32768),
}
ZONES = {"geneactiv": 7200, "gt3x": 7200, "gt3x 12 bits": 7200}  # s east of UTC
BY_FORMAT = pytest.mark.parametrize("name", FILES)


@BY_FORMAT
@pytest.mark.parametrize("ending", ["", ".bin", ".csv", ".dat"])
def test_values_clock_and_unit_under_any_name(name: str, ending: str, tmp_path: Path) -> None:
    data, rate, wanted = FILES[name]
    found = read(saved(tmp_path, data, f"log{ending}"), strict=True)
    np.testing.assert_allclose(in_g(found), wanted, rtol=1e-12)
    np.testing.assert_allclose(force(found).t, np.arange(3000) / rate, atol=1e-9)
    assert found.start_ns == (SECONDS - ZONES.get(name, 0)) * 10**9
    assert found.gaps == ()
    assert name.startswith(found.format)
    assert force(found).unit == "m/s2"


def test_what_a_format_fixes_is_never_refused_by_a_guess(tmp_path: Path) -> None:
    """A sensor that is never at rest, nor near 1 g."""
    rng = np.random.default_rng(5)
    moved = (256 * (rng.normal((3.0, 2.5, 2.5), 0.8, (3000, 3)))).astype(int)
    found = read(saved(tmp_path, ax_file(moved.tolist(), START, axes=0x32, per_sector=80)))
    assert np.median(np.linalg.norm(in_g(found), axis=1)) > 3.0
    assert any("the format fixes the unit" in note for note in found.notes)


def lost_seconds(seconds: range) -> bytes:
    some = [k for k in range(100) if k not in seconds]
    return gt3x(seconds_of(MANY.reshape(-1, 30, 3)[some].reshape(-1, 3), some))


def late_page() -> bytes:
    late = gene_page(MANY[300:600].tolist(), START + timedelta(seconds=6.5), number=1, rate=50.0)
    return gene_file(MANY[:300].tolist(), START) + late


@pytest.mark.parametrize(
    ("data", "gap"),
    [
        (lost_seconds(range(3, 7)), (89 / 30, 7.0)),
        (late_page(), (5.98, 6.5)),
        (wav_file(MANY.tolist(), START, missing=range(300, 400)), (2.99, 4.0)),
    ],
)
def test_samples_that_are_missing_leave_a_gap(
    data: bytes, gap: tuple[float, float], tmp_path: Path
) -> None:
    found = read(saved(tmp_path, data))
    assert [(g.start, g.stop) for g in found.gaps] == [pytest.approx(gap)]


@pytest.mark.parametrize(("hours", "gap"), [(1, "no samples"), (-1, "the clock was set back by")])
def test_a_logger_that_starts_again_loses_nothing(hours: int, gap: str, tmp_path: Path) -> None:
    wanted = counts(1200)
    wanted[7] = [4088, -4096, 8]  # ten bits hold it with an exponent of two
    second = ax_file(counts(1200).tolist(), START + timedelta(hours=hours))[1024:]
    found = read(saved(tmp_path, ax_file(wanted.tolist(), START) + second))
    assert force(found).t.size == 2400
    assert (np.diff(force(found).t) > 0).all()
    assert [g.reason[: len(gap)] for g in found.gaps] == [gap]
    np.testing.assert_allclose(in_g(found)[7], wanted[7] / 256)


def test_an_ax6_turns(tmp_path: Path) -> None:
    wanted = counts(400, one_g=4096, axes=6)
    scales = 4 << 13 | 2 << 10  # 1/2^12 g, 8000/2^2 deg/s
    data = ax_file(wanted.tolist(), START, axes=0x62, per_sector=40, scales=scales)
    found = read(saved(tmp_path, data))
    np.testing.assert_allclose(in_g(found), wanted[:, 3:] / 4096)
    gyro = found.channels["imu0/angular_rate"].values
    np.testing.assert_allclose(gyro, wanted[:, :3] * 2000 / 32768 * DEG)
    assert found.notes[0].startswith("Axivity AX6")


def test_a_sensor_that_is_slow_keeps_the_loggers_time(tmp_path: Path) -> None:
    true, wanted = 98.0, counts(2400)
    out = [ax_header()]
    for k in range(20):
        took = (120 * k + 120) / true  # the clock when the sector is full
        whole, fraction = int(took), int(took % 1 * 32768)
        at = 120 - int(fraction / 32768 * 100)  # as the device moves it, at the rate that it states
        when = START + timedelta(seconds=whole)
        part = wanted[120 * k : 120 * k + 120].tolist()
        out.append(ax_sector(part, when, number=k, at=at, fraction=max(1, fraction)))
    t = force(read(saved(tmp_path, b"".join(out)))).t
    np.testing.assert_allclose(np.diff(t), 1 / true, rtol=0.01)
    assert t[-1] == pytest.approx(2399 / true, abs=0.005)


@pytest.mark.parametrize("rate", [25.0, 100.0])
@pytest.mark.parametrize("share", [1, 3])
def test_sectors_without_a_rate_take_that_of_their_stamps(
    rate: float, share: int, tmp_path: Path
) -> None:
    samples = [(0, 0, 256)] * 12_000
    code = 0x40 | 15 - round(np.log2(3200.0 / rate))
    whole, blind = (ax_file(samples, START, rate=rate, code=c) for c in (code, 0x40))
    mixed = [
        (whole if (k // 512) % share else blind)[k : k + 512] for k in range(1024, len(whole), 512)
    ]
    found = read(saved(tmp_path, whole[:1024] + b"".join(mixed)))
    np.testing.assert_allclose(force(found).t, np.arange(12_000) / rate, atol=0.6 / rate)
    assert not found.gaps


# -- damage -----------------------------------------------------------------------------------


def changed(data: bytes, at: int, stop: int, new: bytes) -> bytes:
    return data[:at] + new + data[stop:]


def flipped(data: bytes, *places: int) -> bytes:
    out = bytearray(data)
    for at in places:
        out[at] ^= 4
    return bytes(out)


CWA, GENE, LOG = FILES["cwa"][0], FILES["geneactiv"][0], seconds_of(MANY, list(range(100)))
IN_SECTOR, PAGE = 1024 + 5 * 512 + 100, GENE.split(b"Recorded Data")[3]


def in_page(old: bytes, new: bytes) -> bytes:
    return GENE.replace(PAGE, PAGE.replace(old, new))


DAMAGED = {
    "cwa flip": (flipped(CWA, IN_SECTOR), 600, 120, "no sound sector"),
    "cwa insert": (changed(CWA, IN_SECTOR, IN_SECTOR, b"seven.."), 600, 120, "no sound sector"),
    "cwa remove": (changed(CWA, IN_SECTOR, IN_SECTOR + 7, b""), 600, 120, "no sound sector"),
    "page digit": (in_page(PAGE[-60:], PAGE[-60:-50] + b"q" + PAGE[-49:]), 600, 300, "page 3"),
    "page cut": (in_page(PAGE[-600:], b"\n"), 600, 300, "1 pages left out; page 3"),
    "page stamp": (in_page(b"Page Time:2020", b"Page Time:20x0"), 600, 300, "page 3"),
    "page rate": (in_page(b"Frequency:50.0", b"Frequency:-1"), 600, 300, "page 3"),
    "record": (gt3x(flipped(LOG, 2000)), 300, 30, "damaged bytes"),
}


@pytest.mark.parametrize("harm", DAMAGED)
def test_damage_costs_its_packet(harm: str, tmp_path: Path) -> None:
    data, first, size, words = DAMAGED[harm]
    path = saved(tmp_path, data)
    found = read(path)
    kind = "cwa" if harm.startswith("cwa") else "geneactiv" if harm.startswith("page") else "gt3x"
    wanted = np.delete(FILES[kind][2], range(first, first + size), axis=0)
    np.testing.assert_allclose(in_g(found), wanted, atol=1e-12)
    assert len(found.gaps) == 1
    assert any(words in note for note in found.notes)
    with pytest.raises(UnreadableInput, match=r"byte \d+|page 3"):
        read(path, strict=True)


def flushed(data: bytes) -> bytes:
    """A gzip stream that ends between two packets, without its end mark."""
    squeeze = zlib.compressobj(wbits=31)
    return squeeze.compress(data) + squeeze.flush(zlib.Z_FULL_FLUSH)


LONG = seconds_of(np.tile(MANY, (9, 1)), list(range(900)))
#: A file, the format that it is of, and what is said; of the archive twice the same bit is another,
#: which the record's own sum does not see.
BROKEN = {
    "no end mark": (flushed(CWA[: 1024 + 5 * 512]), "cwa", "breaks off"),
    "wrong checksum": (flipped(gzip.compress(CWA), -6), "cwa", "breaks off"),
    "packed pages": (gzip.compress(GENE)[:-10_000], "geneactiv", "breaks off"),
    "pages": (GENE[: GENE.rindex(b"Recorded Data")], "geneactiv", "states 10 pages, 9 were found"),
    "wave": (FILES["wav"][0][:-4000], "wav", "3000 samples, 2500 were found|24000 bytes"),
    "archive": (
        gt3x(LONG, method=zipfile.ZIP_STORED).replace(LONG, flipped(LONG, -600, -598)),
        "gt3x",
        "breaks off",
    ),
}


@pytest.mark.parametrize("harm", BROKEN)
def test_a_file_that_breaks_off_gives_what_comes_before(harm: str, tmp_path: Path) -> None:
    data, kind, words = BROKEN[harm]
    path = saved(tmp_path, data)
    found = read(path)
    values = in_g(found)[:3000]
    assert len(values) >= 480
    np.testing.assert_allclose(values, FILES[kind][2][: len(values)], rtol=1e-12)
    assert any(part in note for note in found.notes for part in words.split("|"))
    with pytest.raises(UnreadableInput, match=words):
        read(path, strict=True)


@pytest.mark.parametrize(
    ("method", "piped"),
    [(zipfile.ZIP_STORED, False), (zipfile.ZIP_DEFLATED, False), (zipfile.ZIP_DEFLATED, True)],
)
def test_a_lost_directory_is_told_and_the_checksum_holds(
    method: int, piped: bool, tmp_path: Path
) -> None:
    activity = np.random.default_rng(0).bytes(9 * 400)
    data = zipped(method, piped=piped, info_txt=OLD_INFO.encode(), activity_bin=activity)
    directory = data.index(b"PK\x01\x02")
    whole, cut = (read(saved(tmp_path, d)) for d in (data, data[:directory]))
    assert any("lost its directory" in note for note in cut.notes)
    assert not any("breaks off" in note for note in cut.notes)
    np.testing.assert_array_equal(force(whole).values, force(cut).values)
    crc = zlib.crc32(activity).to_bytes(4, "little")
    path = saved(tmp_path, data[:directory].replace(crc, b"\x5a" * 4))
    assert any("checksum" in note for note in read(path).notes)


def test_records_whose_stamp_is_not_later_are_told(tmp_path: Path) -> None:
    path = saved(tmp_path, gt3x(seconds_of(MANY[:180], [0, 1, 2, 1, 1, 3])))
    found = read(path)
    np.testing.assert_allclose(in_g(found), np.delete(MANY[:180], range(90, 150), axis=0) / 256)
    assert [n[:9] for n in found.notes if "not later" in n] == ["2 records"]
    with pytest.raises(UnreadableInput, match=r"byte \d+ of log\.bin: .*not later"):
        read(path, strict=True)


# -- what is refused --------------------------------------------------------------------------

OLD_LOG = bytes.fromhex("006008EBD007009EBF007008EBF0")
REFUSED = {
    "GENEA": (b"GENEA\r\nVersion:1\r\n\r\n" + bytes(4096), "GENEA.*not read.*readGenea"),
    "Matrix": (b"remarks".ljust(512) + b"MDTC" + bytes(4096), "Matrix.*readParmayMatrix"),
    "zeros": (bytes(4096), "the format is not known"),
    "program": (b"\x7fELF" + bytes(4096), "this is a program"),
    "no gain": (GENE.replace(b"y gain:25457", b"y gain:0"), "gain and offset"),
    "no pages": (b"Device Identity\n" + bytes(40 << 20), "no pages"),
    "marks": (ax_header() + b"AX\xfc\x01" * (1 << 22), "hardly any sound sectors"),
    "packed marks": (gzip.compress(ax_header() + b"AX\xfc\x01" * (1 << 22), 1), "hardly any"),
    "no records": (gt3x(b"\x1e" * (15 << 20)), "no records"),
    "too even": (gt3x(bytes(64 << 20)), "claims 67108864 bytes"),
    "long info": (gt3x(b"", INFO + "x" * (8 << 20)), "longer than"),
    "no rate": (gt3x(LOG, "Serial: 1\n"), "sample rate"),
    "rate 0": (gt3x(LOG, "Sample Rate: 0\n"), "sample rate"),
    "rate inf": (gt3x(LOG, "Sample Rate: inf\n"), "sample rate"),
    "date": (
        zipped(info_txt=OLD_INFO.replace("63", "9" * 40).encode(), activity_bin=OLD_LOG),
        "start date",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_log_is_refused_soon_and_by_its_true_name(name: str, tmp_path: Path) -> None:
    data, words = REFUSED[name]
    path = saved(tmp_path, data, "a.bin")
    start = time.process_time()
    with pytest.raises(UnreadableInput, match=words) as caught:
        read(path)
    assert time.process_time() - start < 10.0
    assert "LOG_BITMASK" not in str(caught.value)


# -- measured files, and what their makers say ------------------------------------------------


def test_the_makers_example(tmp_path: Path) -> None:
    """The three samples that ActiGraph's description of activity.bin works out."""
    found = read(saved(tmp_path, zipped(info_txt=OLD_INFO.encode(), activity_bin=OLD_LOG)))
    wanted = [[0.023, 0.018, -0.947], [0.026, 0.021, -0.941], [0.023, 0.021, -0.947 + 0.006]]
    np.testing.assert_allclose(in_g(found), wanted, atol=0.0006)
    assert any("time zone is not in the file" in note for note in found.notes)


def test_an_axivity_holds_what_another_reader_found() -> None:
    """Counts and times as scikit-digital-health 0.17.18 reads the same file (its own C code)."""
    found = read(MEASURED / "ax3.cwa")
    raw = np.rint(in_g(found) * 256).astype("<i2")
    np.testing.assert_allclose(raw / 256, in_g(found), rtol=1e-12)
    assert raw[:3].tolist() == [[-24, -52, 244], [-16, -12, 236], [-20, -12, 252]]
    assert hashlib.sha256(raw.tobytes()).hexdigest().startswith("8dd389e60c36a418")
    assert force(found).t[-1] == pytest.approx(298.105, abs=0.02)


def test_a_geneactiv_holds_what_another_reader_found() -> None:
    """Values and times as scikit-digital-health 0.17.18 reads the same file (its own C code)."""
    found = read(MEASURED / "geneactiv.bin")
    first = [[-0.88049526, 0.19754881, 0.04023521], [-0.82172244, 0.24075893, 0.0724556]]
    np.testing.assert_allclose(in_g(found)[:2], first, atol=5e-9)
    raw = np.rint((in_g(found) * GAIN + OFFSET) / 100).astype("<i2")
    assert hashlib.sha256(raw.tobytes()).hexdigest().startswith("ad3c2a31de45c592")
    assert force(found).t[[300, -1]].tolist() == pytest.approx([6.5, 18.48])
    assert found.channels["imu0/temperature"].values[[0, -1], 0].tolist() == [28.2, 29.1]


@needs_data
def test_the_makers_own_csv_of_the_same_recording() -> None:
    name = DATA / "actigraph" / "read_gt3x_TAS1H30182785_2019-09-17"
    found = read(name.with_suffix(".gt3x"))
    with gzip.open(name.with_suffix(".csv.gz")) as file:
        rows = np.loadtxt(file, delimiter=",", skiprows=11)
    assert found.start_ns is not None
    first = round((found.start_ns / 1e9 - 4 * 3600 - 1_568_745_600) * 100)
    at = np.rint(force(found).t * 100).astype(int) + first
    assert at.size == 33_000
    assert np.abs(rows[at] - in_g(found)).max() <= 0.00051  # 3 decimals


N = 400
RNG = np.random.default_rng(3)
ACC = np.float32(np.array([0.3, -0.2, -9.8]) + RNG.normal(scale=0.05, size=(2, N, 3)))
GYRO = np.float32(RNG.normal(scale=0.01, size=(2, N, 3)))
STAMPS = 5_000_000 + 4000 * np.arange(N)  # µs since boot


def ulog(path: Path, *, combined: bool = False) -> Path:
    path.write_bytes(flight_logs.ulog(STAMPS, ACC, GYRO, combined=combined))
    return path


def dataflash(path: Path, *, old: bool = False, junk: bytes = b"") -> Path:
    path.write_bytes(flight_logs.dataflash(STAMPS, ACC, GYRO, old=old, junk=junk))
    return path


@pytest.mark.parametrize("old", [False, True])
def test_every_imu_of_a_dataflash_log(old: bool, tmp_path: Path) -> None:
    found = read(dataflash(tmp_path / "1.bin", old=old), strict=True)
    _both(found)
    assert found.format == "dataflash"


@pytest.mark.parametrize("combined", [False, True])
def test_a_px4_log_has_every_sensor_or_what_the_filter_was_fed(
    combined: bool, tmp_path: Path
) -> None:
    pytest.importorskip("pyulog")
    found = read(ulog(tmp_path / "1.ulg", combined=combined), strict=True)
    assert found.format == "ulog"
    if combined:
        assert sorted(found.channels) == ["imu0/acceleration", "imu0/angular_rate"]
        np.testing.assert_array_equal(found.channels["imu0/acceleration"].values, ACC[0])
    else:
        _both(found)


def test_a_damaged_px4_log_is_told_in_notes_not_on_stdout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = ulog(tmp_path / "1.ulg")
    data = bytearray(path.read_bytes())
    at = data.rindex(b"D\x01\x00")  # a message of an unknown number
    data[at + 1 : at + 3] = b"\xff\x3f"
    path.write_bytes(bytes(data))
    found = read(path)
    assert any("damaged" in note for note in found.notes)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(("raw_every", "read_from"), [(200, 0), (2, 1)])
def test_px4_sensors_that_are_thinned_out_give_way_to_what_the_filter_was_fed(
    raw_every: int, read_from: int, tmp_path: Path
) -> None:
    pytest.importorskip("pyulog")
    path = tmp_path / "1.ulg"
    path.write_bytes(flight_logs.ulog(STAMPS, ACC, GYRO, raw_every=raw_every))
    found = read(path, strict=False)
    channel = found.channels["imu0/acceleration"]
    every = (1, raw_every)[read_from]
    np.testing.assert_array_equal(channel.values, ACC[0][::every])
    said = [n for n in found.notes if "sensor_accel 0 (1" in n and "sensor_combined" in n]
    assert bool(said) == (read_from == 0)


def test_bytes_of_no_message_cost_only_themselves(tmp_path: Path) -> None:
    path = dataflash(tmp_path / "1.bin", junk=b"\xa3\x95\x64" + bytes(3) + b"lost")
    found = read(path)
    # The message before them has no other at its end; all others are as written.
    assert any("belong to no message" in note for note in found.notes)
    values = found.channels["imu1/acceleration"].values
    assert len(values) >= N - 2
    assert all(any(np.array_equal(v, a) for a in ACC[1]) for v in values)
    with pytest.raises(UnreadableInput, match="belong to no message"):
        read(path, strict=True)


def _both(found) -> None:  # type: ignore[no-untyped-def]
    for k in range(2):
        acc, gyro = (found.channels[f"imu{k}/{q}"] for q in ("acceleration", "angular_rate"))
        np.testing.assert_array_equal(acc.values, ACC[k])
        np.testing.assert_array_equal(gyro.values, GYRO[k])
        np.testing.assert_allclose(acc.t, STAMPS / 1e6, atol=1e-9)
        warm = found.channels[f"imu{k}/temperature"].values[:, 0]
        np.testing.assert_allclose(warm, 30 + k + np.arange(N) / 1024)
    assert acc.rate == pytest.approx(250.0)
