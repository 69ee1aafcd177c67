"""Cases of the commands that read and write files: inspect, convert, apply, export, validate."""

from __future__ import annotations

import csv

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray

from imucalib.readers import read
from options.bench import Bench
from options.case import Case, Of, ends, writes
from options.outcome import Outcome
from options.recordings import G

INSPECT, NOISE, APPLY = Of("inspect"), Of("noise"), Of("apply")
EXPORT, EFFECTS = Of("export"), Of("effects")
REST = ("inspect", "<pauses.csv>", "--json")
ARRAY = ("apply", "<board_calibration.yaml>", "<log.h5>", "-o", "<out>/corrected.h5")
SIX = ("export", "<calibration.yaml>", "--to", "ggir-csv")
PARTS = ("apply", "<parts.yaml>", "<worn.h5>", "-o", "<out>/corrected.csv")


def _rows(path: object) -> NDArray[np.float64]:
    found = [c for c in read(str(path)).channels.values() if c.quantity == "acceleration"]
    return found[0].values


def _mapping_serves(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The file that was written reads the recording in the same way."""
    writes("m.yaml")(without, done, bench)
    again = bench.run(("inspect", "<samples.csv>", "--json", "--mapping", f"{done.folder}/m.yaml"))
    assert again.content["mapping"] == done.content["mapping"]
    assert "ax_m/s2" in done.text("m.yaml")


def _every_rest(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert done.content["still_segments"] == 12
    assert len(done.content["rests"]) >= 12
    assert "rests" not in without.content


def _longer_rests(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Twelve rests of two seconds; of three there is none."""
    assert (without.content["still_segments"], done.content["still_segments"]) == (12, 0)


def _noise_told(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The file in place of the table."""
    assert "accelerometer_noise_density" in done.stdout
    assert "accelerometer_noise_density" not in without.stdout


def _noise_saved(without: Outcome, done: Outcome, bench: Bench) -> None:
    writes("imu.yaml")(without, done, bench)
    assert done.text("imu.yaml") == without.stdout


def _page(without: Outcome, done: Outcome, bench: Bench) -> None:
    writes("page.html")(without, done, bench)
    page = done.text("page.html")
    assert "pauses.csv" in page
    for channel in done.content["channels"]:
        assert channel["name"] in page


def _by_calibration(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Only the second sensor is corrected."""
    raw = read(bench.path("worn_twice.h5")).channels
    out = read(done.folder / "corrected.h5").channels
    moved = [n for n in raw if raw[n].quantity == "acceleration"
             and np.abs(raw[n].values - out[n].values).max() > 1e-3]  # fmt: skip
    assert moved == ["other/acceleration"]


def _own_is_known(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert without.code != done.code == 0, done.stderr
    assert "--effects" in without.stderr


def _parts_differ(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The parts' own numbers: near the whole's, not the same."""
    one, two = _rows(without.folder / "corrected.csv"), _rows(done.folder / "corrected.csv")
    away = np.abs(one - two).max()
    assert 0.0 < away < 0.02 * G


def _angles(without: Outcome, done: Outcome, bench: Bench) -> None:
    """A row a rest: the angles of the bench's positions, in order."""
    writes("angles.csv")(without, done, bench)
    with (done.folder / "angles.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    column = next(k for k in found[0] if k.startswith("inclination"))
    values = [float(row[column]) for row in found]
    np.testing.assert_allclose(values, np.repeat([-50.0, 10.0], 6), atol=0.3)


def _angles_of_samples(without: Outcome, done: Outcome, bench: Bench) -> None:
    rows = [len(o.text("angles.csv").splitlines()) - 1 for o in (without, done)]
    assert rows[0] == 12
    assert rows[1] > 12 * 50


def _rests_seen(without: Outcome, done: Outcome, bench: Bench) -> None:
    """A message a rest, and a layout beside the file."""
    writes("rests.mcap", "rests.foxglove.json")(without, done, bench)
    with (done.folder / "rests.mcap").open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert sum(topic.endswith("/rest") for topic in topics) == 12


def _channels(outcome: Outcome) -> set[str]:
    return set(read(outcome.folder / "corrected.h5").channels)


def _only_fused(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert all(name.startswith("fused/") for name in _channels(done))
    assert _channels(done) < _channels(without)


def _none_fused(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert not any(name.startswith("fused/") for name in _channels(done))
    assert _channels(done) < _channels(without)


def _felt_elsewhere(without: Outcome, done: Outcome, bench: Bench) -> None:
    """a(p) - a(0) = dω/dt × p + ω × (ω × p), p from the middle, of what is written itself."""
    files = [read(o.folder / "corrected.h5").channels for o in (without, done)]
    force = [f["fused/acceleration"] for f in files]
    rate = next(c.values for n, c in files[0].items()
                if n.startswith("fused/") and c.quantity == "angular_rate")  # fmt: skip
    spin = np.gradient(rate, force[0].t, axis=0)
    p = np.array([0.03, 0.0, 0.0])
    lever = np.cross(spin, p) + np.cross(rate, np.cross(rate, p))
    fast = np.linalg.norm(rate, axis=1) > 3.0
    assert fast.sum() > 100
    left = force[1].values - force[0].values - lever
    assert np.sqrt(np.mean(left[fast] ** 2)) < 0.2 * np.sqrt(np.mean(lever[fast] ** 2))


def _twice(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert without.code != 0
    assert "--again" in without.stderr
    assert "corrected.csv" in done.files


def _with_noise(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert "accelerometer_noise_density" in done.stdout
    assert "accelerometer_noise_density" not in without.stdout or done.stdout != without.stdout


def _with_walks(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Without them nothing says what Kalibr asks for."""
    assert without.code == 2
    assert "random_walk: 2.0e-05" in done.stdout


def _into_a_file(without: Outcome, done: Outcome, bench: Bench) -> None:
    writes("c.h")(without, done, bench)
    assert done.text("c.h") == without.stdout


def _elsewhere(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The last -o is where it goes."""
    assert (set(without.files), set(done.files)) == ({"corrected.csv"}, {"other.csv"})
    assert (done.folder / "other.csv").read_bytes() == without.files["corrected.csv"]


def _as_ggir(without: Outcome, done: Outcome, bench: Bench) -> None:
    """GGIR's six: scale and offset an axis, in g; the C header is another form."""
    assert "scale" in done.stdout
    assert "#define" in without.stdout or "static" in without.stdout
    assert "#" not in done.stdout.splitlines()[-1]


def _with_id(without: Outcome, done: Outcome, bench: Bench) -> None:
    """One parameter more, the id, and one thing less that the form lacks."""
    more = set(done.stdout.splitlines()) - set(without.stdout.splitlines())
    assert more == {"1\t1\tCAL_ACC0_ID\t1310988\t6"}
    assert "CAL_ACC0_ID: " in without.stderr
    assert "CAL_ACC0_ID: " not in done.stderr


def _listed(without: Outcome, done: Outcome, bench: Bench) -> None:
    """One effect more: that of the file."""
    names = [{e["name"] for e in o.content["list"]} for o in (without, done)]
    assert names[1] - names[0] == {"xy_into_z"}
    assert names[0] < names[1]


def _all(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Every section, where a page leaves some out and names them."""
    lines = without.stdout.splitlines()
    assert len(lines) <= 60
    assert "--full shows all" in without.stdout
    assert "--full shows all" not in done.stdout
    assert len(done.stdout.splitlines()) > len(lines)


def _is_called(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert "imucal_left_apply(" in done.stdout
    assert without.stdout.replace("imucal_apply(", "imucal_left_apply(") != without.stdout


CASES: tuple[Case, ...] = (
    INSPECT("--full", _all, "inspect", "<pauses.csv>", "--rests"),
    INSPECT("--save-mapping <out>/m.yaml", _mapping_serves),
    INSPECT("--rests", _every_rest, *REST),
    INSPECT("--shortest-rest 3", _longer_rests, *REST),
    INSPECT("--shortest-rest nan", ends(2), *REST),
    NOISE("--to kalibr", _noise_told, "noise", "<night.h5>"),
    NOISE("--output <out>/imu.yaml", _noise_saved, "noise", "<night.h5>", "--to", "kalibr"),
    NOISE("--output <out>/imu.yaml", ends(2, "--to")),
    NOISE("--html <out>/page.html", writes("page.html")),
    NOISE("--shortest-rest 3", ends(4, "--rests"), "noise", "<pauses.csv>"),
    NOISE("--strict", ends(3, "31"), "noise", "<damaged.csv>"),
    NOISE("--full", _all, "noise", "<night.h5>"),
    INSPECT("--html <out>/page.html", _page, *REST),
    INSPECT("--strict", ends(3, "31"), "inspect", "<damaged.csv>", "--json"),
    APPLY("--output <out>/other.csv", _elsewhere),
    APPLY("--strict", ends(3, "31"), "apply", "<calibration.yaml>", "<damaged.csv>", "-o",
               "<out>/corrected.csv"),
    APPLY("--sensor other", _by_calibration, "apply", "<calibration.yaml>", "<worn_twice.h5>", "-o",
          "<out>/corrected.h5"),
    APPLY("--effects <own.py>", _own_is_known, "apply", "<own_calibration.yaml>", "<samples.csv>",
          "-o", "<out>/corrected.csv"),
    APPLY("--parts", _parts_differ, *PARTS, "--whole"),
    APPLY("--whole", _parts_differ, *PARTS, "--parts"),
    APPLY("--angles <out>/angles.csv", _angles, "apply", "<calibration.yaml>", "<pauses.csv>", "-o",
          "<out>/corrected.csv"),
    APPLY("--residuals <out>/rests.mcap", _rests_seen, "apply", "<calibration.yaml>",
          "<pauses.csv>", "-o", "<out>/corrected.csv"),
    APPLY("--each sample", _angles_of_samples, "apply", "<calibration.yaml>", "<pauses.csv>", "-o",
          "<out>/corrected.csv", "--angles", "<out>/angles.csv"),
    APPLY("--fused", _only_fused, *ARRAY),
    APPLY("--no-fused", _none_fused, *ARRAY),
    APPLY("--at 30,0,0", _felt_elsewhere, *ARRAY, "--fused"),
    APPLY("--at nan,0,0", ends(2), *ARRAY),
    APPLY("--again", _twice, "apply", "<calibration.yaml>", "<corrected.csv>", "-o",
          "<out>/corrected.csv"),
    EXPORT("--name left", _is_called),
    EXPORT("--to urdf", ends(2, "one accelerometer")),
    EXPORT("--to ggir-csv", _as_ggir),
    EXPORT("--device-id 1310988", _with_id, "export", "<calibration.yaml>", "--to", "px4"),
    EXPORT("--device-id 7", ends(2, "px4 and ardupilot"), *SIX),
    EXPORT("--largest-loss 1e-9", ends(1, "--force"), *SIX),
    EXPORT("--largest-loss -1", ends(2), *SIX),
    EFFECTS("--effects <own.py>", _listed),
    EXPORT("--output <out>/c.h", _into_a_file),
    EXPORT("--noise <imu.yaml>", _with_noise, "export", "<board_calibration.yaml>", "--to",
           "kalibr"),
    EXPORT("--random-walk 0.001,2e-05", _with_walks, "export", "<board_calibration.yaml>", "--to",
           "kalibr"),
    EXPORT("--random-walk 0.001", ends(2, "ACC,GYRO")),
    EXPORT("--effects <own.py>", _own_is_known, "export", "<own_calibration.yaml>", "--to",
           "c-header"),
)  # fmt: skip
