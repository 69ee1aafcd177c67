"""Small recordings of the cases: worn sensors, boards, logs, and files written in odd ways."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from imucalib.calibrators.actigraph.simulation import WeekPlan
from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.simulation import LogPlan, simulate_log
from imucalib.readers import read
from imucalib.readers.fields.joining import join
from imucalib.recording.recording import Recording
from imucalib.writers import write
from options.inputs import TABLES, Make, Rows, rows, still
from options.outcome import run
from worlds.places import ROOT
from worlds.recordings import recording_of
from worlds.turned_imu import Log, chip, turned
from worlds.week import simulated_blocks

G = 9.80665
BOARD = """name: four
prior_sd: 3.0
accelerometer_range: 16.0
gyroscope_range: 2000.0
imus:
  - {name: imu0, position: [-9.0, 9.0, 1.0], axes: "x,y,z"}
  - {name: imu1, position: [9.0, 9.0, -1.0], axes: "x,y,z"}
  - {name: imu2, position: [-9.0, -9.0, -1.0], axes: "x,y,z"}
  - {name: imu3, position: [9.0, -9.0, 1.0], axes: "x,y,z"}
"""


def _worn(path: Path, days: float = 0.2, seed: int = 1) -> None:
    write(join(simulated_blocks(WeekPlan(days=days, rate=5.0), seed), "made"), path)


def _bent(path: Path) -> None:
    """Half a day of a converter with a ripple of 8 mg on x."""
    made = join(simulated_blocks(WeekPlan(days=0.5, rate=5.0), 2), "made")
    write(_rippled(made, 0.008, 7.0), path)


def _rippled(made: Recording, size: float, waves: float) -> Recording:
    """x axes that read `size` (g) sin(waves x / g) too much."""
    out = dict(made.channels)
    for name, c in made.channels.items():
        if c.quantity == "acceleration":
            ripple = size * G * np.sin(waves * c.values / G) * np.array([1.0, 0.0, 0.0])
            out[name] = replace(c, values=c.values + ripple)
    return replace(made, channels=out)


def _turned() -> Log:
    rng = np.random.default_rng(2)
    return turned(chip(rng), rng, rests=20)


def _turns(path: Path) -> None:
    _turned().write(path)


def _turned_axes(path: Path) -> None:
    """The same with x and y of the gyroscope exchanged."""
    log = _turned()
    replace(log, rate=log.rate[:, [1, 0, 2]]).write(path)


def _bent_turns(path: Path) -> None:
    """An accelerometer whose x ripples by 10 mg."""
    rng = np.random.default_rng(3)
    log = turned(chip(rng), rng, rests=45)
    ripple = 0.01 * np.sin(6.0 * log.force) * np.array([1.0, 0.0, 0.0])
    replace(log, force=log.force + ripple).write(path)


def _loose(path: Path) -> None:
    """A board whose imu1 wanders by half a millimetre while it is twisted."""
    board_log(path)
    made = read(path)
    rate, felt = made.channels["imu1/angular_rate"], made.channels["imu1/acceleration"]
    w = rate.values
    off = np.array([6e-4, -4e-4, 4e-4])
    late = np.clip((rate.t - 36.0) / 20.0, 0.0, 1.0)[:, None] - 0.5
    spin = np.gradient(w, rate.t, axis=0)
    moved = late * (np.cross(w, np.cross(w, off)) + np.cross(spin, off))
    changed = replace(felt, values=felt.values + moved)
    write(replace(made, channels={**made.channels, "imu1/acceleration": changed}), path)


def _worn_twice(path: Path) -> None:
    """Two accelerometers on one wrist, the second with its x axis 3 % longer."""
    made = join(simulated_blocks(WeekPlan(days=0.2, rate=5.0), 1), "made")
    (name,) = (n for n, c in made.channels.items() if c.quantity == "acceleration")
    one = made.channels[name]
    other = replace(one, values=one.values * np.array([1.03, 1.0, 1.0]), triad="other")
    write(replace(made, channels={**made.channels, "other/acceleration": other}), path)


def _board(path: Path) -> None:
    path.write_text(BOARD, encoding="utf-8")


def _exchanged_board(path: Path) -> None:
    swapped = BOARD.replace("imu1, pos", "imuX, pos").replace("imu2, pos", "imu1, pos")
    path.write_text(swapped.replace("imuX, pos", "imu2, pos"), encoding="utf-8")


def board_log(path: Path) -> None:
    folder = path.parent / "board.yaml"
    _board(folder)
    plan = LogPlan(poses=12, pose_seconds=3.0, seconds=20.0, gyro_gain=0.0)
    write(simulate_log(read_board(folder), plan, np.random.default_rng(3)).recording, path)


def samples() -> Rows:
    """(60, 8) t s, acceleration m/s², rate rad/s, temperature °C: any numbers."""
    rng = np.random.default_rng(0)
    t = np.arange(60) / 20.0
    a = np.array([0.3, -0.2, 9.7]) + 0.3 * rng.standard_normal((60, 3))
    w = 0.4 * rng.standard_normal((60, 3))
    return np.round(np.column_stack([t, a, w, 20.0 + t]), 6)


def _in_counts(table: Rows) -> Rows:
    """256 counts a g, 3 counts at zero."""
    table[:, 1:4] = table[:, 1:4] / G * 256.0 + 3.0
    return table


def _in_g(table: Rows) -> Rows:
    table[:, 1:4] /= G
    return table


def _as_euroc(table: Rows) -> Rows:
    return np.column_stack([table[:, 0], table[:, 4:7], table[:, 1:4]])


def _more_axes(table: Rows) -> Rows:
    """A second accelerometer, turned about x."""
    return np.column_stack([table, table[:, 1], table[:, 3], -table[:, 2]])


LOG = "time,ax,ay,az,gx,gy,gz,temp"


def log(
    heading: str = LOG, *, mark: str = ",", first: str = "", decimal: str = ".",
    stamps: float = 1.0, of: Callable[[Rows], Rows] = lambda table: table,
) -> Make:  # fmt: skip
    """A CSV of `samples`."""

    def made(path: Path) -> None:
        table = of(samples() * np.array([stamps, *[1.0] * 7]))
        lines = [mark.join(f"{v:.12g}".replace(".", decimal) for v in row) for row in table]
        text = "\n".join([heading.replace(",", mark), *lines]) + "\n"
        path.write_text(first + text, encoding="utf-8")

    return made


def _odd_stamps(path: Path) -> None:
    """Stamps whose day and month only a format tells, in a zone whose name two zones have."""
    log(LOG)(path)
    heading, *lines = path.read_text(encoding="utf-8").splitlines()
    moved = [line.partition(",") for line in lines]
    made = [f"02/03/2024 10:00:{float(t):06.3f} CST,{rest}" for t, _, rest in moved]
    path.write_text("\n".join([heading, *made]) + "\n", encoding="utf-8")


def _two_tools(path: Path) -> None:
    """The samples of tool A12, each followed by one of tool B07."""
    log("tool," + LOG)(path)
    heading, *lines = path.read_text(encoding="utf-8").splitlines()
    other = [",".join(["B07", line.split(",")[0], *["0.5"] * 7]) for line in lines]
    made = [part for a, b in zip(lines, other, strict=True) for part in (f"A12,{a}", b)]
    path.write_text("\n".join([heading, *made]) + "\n", encoding="utf-8")


def _in_kelvin(table: Rows) -> Rows:
    table[:, 7] += 273.15
    return table


def _counts(path: Path) -> None:
    path.write_text(
        "time: time\nacc: [ax, ay, az]\nacc_unit: counts\nlsb_per_g: [256]\n"
        "gyro: [gx, gy, gz]\ngyro_unit: rad/s\ntemperature: [temp]\n",
        encoding="utf-8",
    )


def _damaged(path: Path) -> None:
    log("time_s,ax_m/s2,ay_m/s2,az_m/s2,gx_rad/s,gy_rad/s,gz_rad/s,temp_C")(path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[30] = "1.45,oops,0,9.8,0,0,0,21"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _rests_of(path: Path) -> None:
    """Rests of 2 s in the bench's positions, with motion between."""
    still(path, seconds=(2.0,), table=rows()[:12])


def _unstamped(make: Make) -> Make:
    """A table without its column of times."""

    def made(path: Path) -> None:
        make(path)
        rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
        kept = [",".join(row[1:]) for row in rows if len(row) > 1]
        path.write_text("\n".join(kept) + "\n", encoding="utf-8")

    return made


def _packed(path: Path) -> None:
    t = np.arange(4000) / 100.0
    values = np.tile([0.1, 0.2, 9.8], (4000, 1))
    write(recording_of(t, values, hz=100.0), path)


def _external(path: Path) -> None:
    """HDF5 whose acceleration lies in a file beside it."""
    table = samples()
    beside = path.with_suffix(".raw")
    beside.write_bytes(table[:, 1:4].astype("<f8").tobytes())
    with h5py.File(path, "w") as file:
        file["time"] = np.round(table[:, 0] * 1e9).astype("i8")
        file["time"].attrs["units"] = "ns"
        file.create_dataset("acc", (60, 3), "<f8", external=[(str(beside), 0, 60 * 24)])
        file["acc"].attrs["units"] = "m/s2"


def _night(path: Path) -> None:
    """Ten minutes still, with a gyroscope: enough for the noise of every axis."""
    rng = np.random.default_rng(4)
    t = np.arange(12000) / 20.0
    a = np.array([0.0, 0.0, G]) + 0.02 * rng.standard_normal((12000, 3))
    w = 0.002 * rng.standard_normal((12000, 3))
    write(recording_of(t, a, w, hz=20.0), path)


def _noise_file(path: Path) -> None:
    night = path.parent / "night.h5"
    if not night.exists():
        _night(night)
    done = run(["noise", str(night), "--to", "kalibr", "-o", str(path)], path.parent)
    assert done.code == 0, done.stderr


def _entries(path: Path) -> None:
    cohort = path.parent / "cohort.txt"
    if not cohort.exists():
        _cohort(cohort)
    done = run(["batch", str(cohort), "-o", str(path), "-q", "--", "--no-loop"], path)
    assert done.code == 0, done.stderr


def _cohort(path: Path) -> None:
    for k in (1, 2):
        _worn(path.parent / f"worn{k}.h5", 0.12, seed=k)
    path.write_text("worn1.h5\nworn2.h5\n", encoding="utf-8")


def _own_effects(path: Path) -> None:
    """The worked example of the page."""
    page = (ROOT / "docs" / "own_effect.md").read_text(encoding="utf-8")
    found = re.search(r"```python[^\n]*\n(.*?)```", page, flags=re.S)
    assert found
    path.write_text(found[1], encoding="utf-8")


def _made_by(*arguments: str, keeps: str = "calibration.yaml") -> Make:
    """What a command leaves behind; {name} is an input."""

    def made(path: Path) -> None:
        folder = path.parent / f"for_{path.name}"
        words = [_placed(text, path.parent) for text in arguments]
        target = folder if keeps == "calibration.yaml" else folder / keeps
        done = run([*words, "-o", str(target)], folder)
        assert done.code in (0, 5), done.stderr
        (folder / keeps).rename(path)

    return made


def _placed(text: str, folder: Path) -> str:
    """An argument, the input that it names made where it is not there yet."""
    if not text.startswith("{"):
        return text
    path = folder / text.strip("{}")
    if not path.exists():
        {**TABLES, **RECORDINGS}[path.name](path)
    return str(path)


RECORDINGS: dict[str, Make] = {
    "worn.h5": _worn,
    "worn_twice.h5": _worn_twice,
    "bent.h5": _bent,
    "loose_log.h5": _loose,
    "board.yaml": _board,
    "exchanged.yaml": _exchanged_board,
    "tight.yaml": lambda path: path.write_text(BOARD.replace("prior_sd: 3.0", "prior_sd: 0.001")),
    "log.h5": board_log,
    "turns.csv": _turns,
    "turned_axes.csv": _turned_axes,
    "bent_turns.csv": _bent_turns,
    "samples.csv": log("time_s,ax_m/s2,ay_m/s2,az_m/s2,gx_rad/s,gy_rad/s,gz_rad/s,temp_C"),
    "bare.csv": log(),
    "counts.csv": log(of=_in_counts),
    "in_g.csv": log(of=_in_g),
    "other_axes.csv": log("time,ax,ay,az,gx,gy,gz,temp,bx,by,bz", of=_more_axes),
    "comma_log.csv": log(mark=";", decimal=","),
    "piped_log.csv": log(mark="^"),
    "counts.yaml": _counts,
    "titled_log.csv": log(first="1,2,3,4,5,6,7,8\n8,7,6,5,4,3,2,1\n"),
    "columns.csv": log("c1,c2,c3,c4,c5,c6,c7", stamps=1e9, of=_as_euroc),
    "stamps_ms.csv": log(stamps=1000.0),
    "odd_stamps.csv": _odd_stamps,
    "two_tools.csv": _two_tools,
    "kelvin.csv": log(of=_in_kelvin),
    "damaged.csv": _damaged,
    "pauses.csv": _rests_of,
    "unstamped_rests.csv": _unstamped(still),
    "unstamped_turns.csv": _unstamped(_turns),
    "packed.mcap": _packed,
    "external.h5": _external,
    "night.h5": _night,
    "calibration.yaml": _made_by("lab", "{bench.csv}", "--no-loop"),
    "own_calibration.yaml": _made_by(
        "lab", "{bench.csv}", "--no-loop", "--effects", "{own.py}", "--declare", "xy_into_z"
    ),
    "crossed_calibration.yaml": _made_by(
        "lab", "{crossed.csv}", "--no-loop", "--effects", "{own.py}", "--declare", "xy_into_z"
    ),
    "parts.yaml": _made_by("actigraph", "{worn.h5}", "--no-loop", "--every", "80min"),
    "board_calibration.yaml": _made_by(
        "array", "{log.h5}", "--board", "{board.yaml}", "--no-loop", "--samples", "40"
    ),
    "corrected.csv": _made_by(
        "apply", "{calibration.yaml}", "{samples.csv}", keeps="corrected.csv"
    ),
    "entries": _entries,
    "imu.yaml": _noise_file,
    "cohort.txt": _cohort,
    "own.py": _own_effects,
}
