"""Text exports as delivered, their headings as published, and dialects that a file adds."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers import devices as folder
from imucalib.readers import read
from imucalib.readers.devices.catalogue import devices, with_preset
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.units import DEG, STANDARD_GRAVITY

G = np.array([0.02, -0.01, 1.0]) + np.random.default_rng(0).normal(scale=0.003, size=(400, 3))
TURN = np.array([0.1, -0.2, 0.3])


def cells(values: np.ndarray, form: str = "%.6f") -> list[str]:
    return [form % v for v in values]


def table(head: str, row: Callable[[int], list[str]], mark: str = ",", end: str = "") -> str:
    return head + "".join(mark.join(row(k)) + end + "\n" for k in range(len(G)))


def shimmer() -> str:
    names = [f"Shimmer_60F7_{n}_CAL" for n in ("Timestamp_FormattedUnix", *(
        f"Accel_WR_{a}" for a in "XYZ"), *(f"Gyro_{a}" for a in "XYZ"))]  # fmt: skip
    units = ["yyyy/mm/dd hh:mm:ss.000"] + 3 * ["m/(s^2)"] + 3 * ["deg/s"]
    head = '"sep=\t"\n' + "\t".join(names) + "\t\n" + "\t".join(units) + "\t\n"
    return table(
        head,
        lambda k: [
            f"2017/03/08 12:57:{10 + k // 50:02d}.{k % 50 * 20:03d}",
            *cells(STANDARD_GRAVITY * G[k]),
            *cells(TURN),
        ],
        "\t",
        "\t",
    )


def shimmer_unix() -> str:
    names = ["S_Seat_Timestamp_Unix_CAL", *(f"S_Seat_Accel_LN_{a}_CAL" for a in "XYZ")]
    head = '"sep=,"\n' + ",".join(names) + ",\nms,m/(s^2),m/(s^2),m/(s^2),\n"
    return table(head, lambda k: [f"{1488977830000 + 20 * k}.0", *cells(STANDARD_GRAVITY * G[k])],
                 end=",")  # fmt: skip


def empatica() -> str:
    head = "1544027337.500000, 1544027337.500000, 1544027337.500000\n"
    head += "32.000000, 32.000000, 32.000000\n"
    return table(head, lambda k: cells(np.rint(64 * G[k]), "%d"))


def ax6() -> str:
    head = "Time,Accel-X (g), Accel-Y (g), Accel-Z (g), Gyro-X (d/s), Gyro-Y (d/s), Gyro-Z (d/s)\n"
    return table(
        head,
        lambda k: [
            f"2020-03-01 12:00:{k // 50:02d}.{k % 50 * 20:03d}", *cells(G[k]), *cells(TURN),
        ],
    )  # fmt: skip


def mbientlab(what: str) -> str:
    unit, values = ("g", G) if what == "acc" else ("deg/s", np.tile(TURN, (400, 1)))
    axes = ",".join(f"{a}-axis ({unit})" for a in "xyz")
    return table(f"epoch (ms),time (-13:00),elapsed (s),{axes}\n", lambda k: [
        f"{1544027337000 + 20 * k}", f"2018-12-05T08.28.{k // 50:02d}.{k % 50 * 20:03d}",
        f"{k / 50:.3f}", *cells(values[k])])  # fmt: skip


def gcdc(scale: float) -> str:
    head = """;Title, http://www.gcdataconcepts.com, X16-1C
;Version, 1409, Build num, 0x21E, Build date, 20120404 13:16:08,  SN:CCDC42011002237
;Start_time, 2012-10-24, 03:29:25.409
;Temperature, 35.00, deg C,  Vbat, 1681, mv
;Gain, low
;SampleRate, 50,Hz
;Deadband, 0, counts
;DeadbandTimeout, 1,sec
;Headers, time,Ax,Ay,Az
"""
    return table(head, lambda k: [f"{0.266 + k / 50:.3f}", *cells(scale * G[k], "%d")])


def sensorlog() -> str:
    names = ["loggingTime(txt)", "locationSpeed(m/s)", "accelerometerTimestamp_sinceReboot(s)"]
    names += [f"accelerometerAcceleration{a}(G)" for a in "XYZ"]
    names += [f"motionUserAcceleration{a}(G)" for a in "XYZ"]
    names += [f"motionGravity{a}(G)" for a in "XYZ"] + [f"gyroRotation{a}(rad/s)" for a in "XYZ"]
    return table(",".join(names) + "\n", lambda k: [
        f"2019-05-21 16:16:{k // 50:02d}.{k % 50 * 20:03d} +0200", "0.0", f"{62608 + k / 50:.6f}",
        *cells(G[k]), *3 * ["0.001"], *3 * ["0.5"], *cells(DEG * TURN, "%.9f")])  # fmt: skip


def geneactiv() -> str:
    head = ["Device Type,GENEActiv", "Measurement Frequency,50.0 Hz", "Time Zone,GMT +01:00"]
    head += [f"Field {k},value {k}" for k in range(97)]
    return table(
        "\n".join(head) + "\n",
        lambda k: [
            f"2012-05-01 10:00:{k // 50:02d}:{k % 50 * 20:03d}",
            *cells(G[k]),
            "12",
            "0",
            "25.5",
        ],
    )


def axivity(unix: bool) -> str:
    return table("", lambda k: [
        f"{1600000000 + k / 50:.4f}" if unix else
        f"2020-09-13 12:26:{40 + k // 50:02d}.{k % 50 * 20:03d}", *cells(G[k])])  # fmt: skip


def xsens() -> str:
    head = (
        "// General information: \n//  MT Manager version: 2022.2.0 \n// Device information: \n"
        "//  DeviceId: 0\n//  Update Rate: 50.0Hz\n// Coordinate system: ENU\n"
        "PacketCounter\tSampleTimeFine\tYear\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\tRoll\t\n"
    )
    return table(head, lambda k: [
        f"{5 + k}", "NaN", "NaN", *cells(STANDARD_GRAVITY * G[k]), *cells(DEG * TURN, "%.9f"),
        "1.5"], "\t", "\t")  # fmt: skip


def euroc() -> str:
    head = "#timestamp [ns]" + "".join(f",w_RS_S_{a} [rad s^-1]" for a in "xyz")
    head += "".join(f",a_RS_S_{a} [m s^-2]" for a in "xyz") + "\n"
    return table(head, lambda k: [
        f"{1403636579758555392 + 20_000_000 * k}", *cells(DEG * TURN, "%.9f"),
        *cells(STANDARD_GRAVITY * G[k])])  # fmt: skip


@pytest.mark.parametrize(
    ("text", "triad", "gyro", "start", "resolution"),
    [
        (shimmer(), "shimmer_60f7_wr", "shimmer_60f7_wr", 1_488_977_830.0, 1e-6),
        (shimmer_unix(), "seat_ln", "", 1_488_977_830.0, 1e-6),
        (empatica(), "imu0", "", 1_544_027_337.5, 0.0079),
        (ax6(), "imu0", "imu0", 1_583_064_000.0, 1e-6),
        (mbientlab("acc"), "imu0", "", 1_544_027_337.0, 1e-6),
        (mbientlab("gyro"), "", "imu0", 1_544_027_337.0, 1e-6),
        (gcdc(2048), "imu0", "", 1_351_049_365.409, 0.0005),
        (gcdc(1024), "imu0", "", 1_351_049_365.409, 0.001),
        (sensorlog(), "imu0", "imu0", None, 1e-6),
        (geneactiv(), "imu0", "", 1_335_866_400.0, 1e-6),
        (axivity(True), "imu0", "", 1_600_000_000.0, 1e-6),
        (axivity(False), "imu0", "", 1_600_000_000.0, 1e-6),
        (xsens(), "imu0", "imu0", None, 1e-6),
        (euroc(), "imu0", "imu0", 1_403_636_579.758555392, 1e-6),
    ],
)
def test_an_export_is_read_as_delivered(
    text: str, triad: str, gyro: str, start: float | None, resolution: float, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    found = read(path)
    names = {f"{triad}/acceleration"} if triad else set()
    names |= {f"{gyro}/angular_rate"} if gyro else set()
    names |= {"imu0/temperature"} if "GENEActiv" in text else set()
    assert set(found.channels) == names
    if triad:
        acc = found.channels[f"{triad}/acceleration"]
        np.testing.assert_allclose(acc.values / STANDARD_GRAVITY, G, atol=1.01 * resolution)
        step = 1 / 32 if "32.000" in text else 1 / 50
        np.testing.assert_allclose(np.diff(acc.t), step, atol=1e-6)
    if gyro:
        rate = found.channels[f"{gyro}/angular_rate"].values
        np.testing.assert_allclose(rate, np.tile(DEG * TURN, (400, 1)), atol=1e-8)
    assert found.start_ns == (None if start is None else pytest.approx(start * 1e9, abs=1000))
    again = read(path, from_dict(found.mapping))
    for name, channel in found.channels.items():
        np.testing.assert_allclose(again.channels[name].values, channel.values, rtol=1e-12)


@pytest.mark.parametrize(
    ("lines", "force", "turn"),
    [
        (";LSM6DSM, SR,104,Hz, Units, mG, mdps, fullscale gyro 250dps, accel 4g", 1000, 1000),
        (";Accel, 225, 1000, 16, g\n;Gyro, 225, 1, 250, dps", 1000, 1),
    ],
)
def test_units_that_a_logger_states_are_no_counts(
    lines: str, force: float, turn: float, tmp_path: Path
) -> None:
    head = (
        f";Title, http://www.gcdataconcepts.com, HAM-IMU\n{lines}\n;Time, Ax, Ay, Az, Gx, Gy, Gz\n"
    )
    path = tmp_path / "a.csv"
    path.write_text(
        table(head, lambda k: [f"{k / 50}", *cells(force * G[k], "%d"), *cells(turn * 9 * TURN)])
    )
    found = read(path)
    values = found.channels["imu0/acceleration"].values / STANDARD_GRAVITY
    np.testing.assert_allclose(values, G, atol=1.01 / force)
    rate = found.channels["imu0/angular_rate"].values / DEG
    np.testing.assert_allclose(rate, np.tile(9 * TURN, (400, 1)), atol=1e-9)


def test_counts_that_may_be_mg_are_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(table("t [s],x,y,z\n", lambda k: [f"{k / 50}", *cells(1024 * G[k], "%d")]))
    with pytest.raises(UnreadableInput, match="--lsb 1024"):
        read(path)
    for unit, scale in (("counts", (1024.0,)), ("mg", ())):
        found = read(path, FieldMapping(acc_unit=unit, lsb_per_g=scale))
        norm = np.median(np.linalg.norm(found.channels["imu0/acceleration"].values, axis=1))
        assert norm / STANDARD_GRAVITY == pytest.approx(1.0 if scale else 1.024, rel=0.002)


#: All that a new dialect takes: the text of one file.
NEW = """
from imucalib.readers.devices.catalogue import Device, DeviceStart
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "tumbler",
    FieldMapping(acc=("2", "3", "4"), temperature=("5",), acc_unit="mg", temperature_unit="degC"),
    words=("tumbler 3000",),
    start=lambda text: DeviceStart(16 * 10**17, ("the start is the maker's birthday",)),
)
"""
TABLE = "Tumbler 3000 data logger, sample rate 50 Hz\n" + "".join(
    f"{k};{a};{b};{c};{21 + k % 2}\n"
    for k, (a, b, c) in enumerate(np.tile([[3, -1000, 12]], (200, 1)) + np.arange(200)[:, None] % 3)
)


@pytest.fixture
def tumbler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    room = tmp_path / "more_devices"
    room.mkdir()
    (room / "tumbler.py").write_text(NEW, encoding="utf-8")
    monkeypatch.setattr(folder, "__path__", [*folder.__path__, str(room)])
    devices.cache_clear()
    yield
    devices.cache_clear()
    sys.modules.pop("imucalib.readers.devices.tumbler", None)


def test_a_new_dialect_is_one_file(tumbler: None, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(TABLE, encoding="utf-8")
    found = readers.read(path)
    acc, warm = found.channels["imu0/acceleration"], found.channels["imu0/temperature"]
    assert np.allclose(acc.values[:3, 1], np.array([-1.0, -0.999, -0.998]) * 9.80665)
    assert list(warm.values[:3, 0]) == [21.0, 22.0, 21.0]
    assert found.start_ns == 1_600_000_000_000_000_000
    assert "the start is the maker's birthday" in found.notes
    assert found.mapping["preset"] == "tumbler"
    assert with_preset(FieldMapping(preset="tumbler")).acc_unit == "mg"


def test_without_that_file_the_dialect_is_unknown(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(TABLE, encoding="utf-8")
    with pytest.raises(UnreadableInput, match="--acc"):
        readers.read(path)


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(UsageError, match=r"unknown preset.*actigraph"):
        with_preset(FieldMapping(preset="nokia"))
