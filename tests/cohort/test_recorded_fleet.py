"""A fleet of finished calibrations: worn sensors recorded more than once, arrays, batches.

Reports are written by plain numpy: y = B θ + X s + noise, 150 postures a recording, with the
products of its columns worked out here a second time.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import read, to_yaml
from imucalib.calibration.sums import KEY
from imucalib.calibration.triads import triad_from
from imucalib.calibrators.population import read as read_population
from imucalib.cohort.entries import Entry, write_entry
from imucalib.cohort.fleet.outcome import Fleet
from imucalib.cohort.fleet.recorded import Wanted, load_calibrations, run_recorded
from imucalib.core.effect import Context
from imucalib.core.fit import StoredParameter
from imucalib.effects import named
from imucalib.errors import UnreadableInput, UsageError
from worlds.command import run

NINE = ("bias", "scale", "non_orthogonality")
BASE = [(e, p) for e in NINE for p in named(e).parameters(Context(1))]
POSTURES, NOISE = 150, 0.5
_STAGES = {"positions": "array"}


def report(
    name: str, theta: np.ndarray, sizes: np.ndarray, seed: int, kind: str = "actigraph",
    status: str = "ok",
) -> dict:  # fmt: skip
    """What a recording's report.json must hold for a fleet. theta : (9,) in its units; sizes : (6,)
    in typical ones; the columns are as strong as a week's: 0.6 in units of the noise."""
    rng = np.random.default_rng(seed)
    typical = np.array([p.typical for _, p in BASE])
    base = 30.0 * rng.standard_normal((POSTURES, 9))
    columns = 0.05 * rng.standard_normal((POSTURES, 6)) + 0.01 * base[:, :6]
    y = base @ (theta / typical) + columns @ sizes + rng.standard_normal(POSTURES)
    gram = base.T @ base
    taken = np.linalg.solve(gram, base.T @ columns)
    rest = columns - base @ taken
    covariance = np.linalg.inv(gram) * np.outer(typical, typical)
    found = np.linalg.solve(gram, base.T @ y) * typical
    lower = rest.T @ rest
    return {
        "calibrator": kind,
        "status": status,
        "parameters": [
            {"name": p.name, "effect": e, "value": v, "sd": s, "unit": p.unit}
            for (e, p), v, s in zip(BASE, found, np.sqrt(np.diag(covariance)), strict=True)
        ],
        "covariance": {"estimated_noise": covariance.tolist()},
        "notes": [],
        "loop": {"steps": []},
        "provenance": {
            "input": name, "sha256": name, "samples": 1, "gaps": 0, "mapping": {}, "settings": {},
            "seed": 0, "versions": {}, "time": "2026-01-01T00:00:00Z", "command": "",
        },
        KEY: {
            "parameters": [p.name for _, p in BASE], "theta": found.tolist(),
            "covariance": covariance.tolist(),
            "blocks": {"temperature_bias": [0, 3], "quadratic": [3, 6]},
            "gram": [row[: k + 1].tolist() for k, row in enumerate(lower)],
            "along": (rest.T @ y).tolist(), "taken": (taken * typical[:, None]).tolist(),
            "noise_mg": NOISE, "noise_dof": POSTURES - 9.0, "wander_mg": 0.0,
        },
    }  # fmt: skip


def device(rng: np.random.Generator, bias: float = 20.0) -> np.ndarray:
    """(9,) mg and shares."""
    spread = np.array([bias] * 3 + [0.01] * 6)
    return spread * rng.standard_normal(9)


def cohort(
    folder: Path, devices: int, size: float, *, per: int = 2, within: float = 1.0, odd: int = -1
) -> tuple[list[Path], Path, np.ndarray]:
    """Reports, `per` of each device, the table of who is who, and the sizes (devices, 3)
    of the temperature; device `odd` has a bias that no other has."""
    rng = np.random.default_rng(7)
    truth = size * (1.0 + 0.3 * rng.standard_normal((devices, 3)))
    paths, rows = [], ["recording,device"]
    for k, own in enumerate(truth):
        theta = device(rng) + (400.0 if k == odd else 0.0) * np.eye(9)[0]
        for r in range(per):
            name = f"d{k}_{r}.csv"
            moved = theta + within * np.r_[rng.standard_normal(3), np.zeros(6)]
            content = report(name, moved, np.r_[own, np.zeros(3)], 100 * k + r)
            paths.append(entry_of(folder / f"{name}.json", content))
            rows.append(f"{name},dev{k}")
    table = folder / "devices.csv"
    table.write_text("\n".join(rows) + "\n")
    return paths, table, truth


def pooled(paths: Sequence[Path], table: Path | None) -> Fleet:
    return run_recorded(paths, Wanted(devices=table), lambda _: None)


@pytest.mark.slow
def test_what_no_recording_shows_alone_is_found_in_all(tmp_path: Path) -> None:
    paths, table, truth = cohort(tmp_path, 12, 2.0)
    found = pooled(paths, table)
    assert [one.effect for one in found.search.found] == ["temperature_bias"]
    assert [m.name for m in found.members] == [f"dev{k}" for k in range(12)]
    assert [len(m.recordings) for m in found.members] == [2] * 12
    sizes = found.search.found[0].sizes
    assert np.abs(sizes.common - truth.mean(axis=0)).max() < 1.5
    assert found.verdict == "explained"
    assert found.difference.nats_low > 0.0


def test_a_clean_cohort_stays_clean(tmp_path: Path) -> None:
    paths, table, _ = cohort(tmp_path, 8, 0.0)
    found = pooled(paths, table)
    assert (found.verdict, found.exit_code, found.outliers) == ("nothing found", 0, ())
    assert all(m.base == m.final == NOISE for m in found.members)


@pytest.mark.slow
def test_scatter_between_devices_and_between_recordings_of_one(tmp_path: Path) -> None:
    """20 mg and 1 mg were put in; 60 and 60 degrees of freedom: 4.5 sd are 41 %."""
    paths, table, _ = cohort(tmp_path, 60, 0.0)
    bias = next(s for s in pooled(paths, table).spreads if s.name == "bias_x")
    assert bias.scatter == pytest.approx(20.0, rel=0.41)
    assert bias.sessions.sd == pytest.approx(1.0, rel=0.41)
    assert bias.sessions.low < 1.0 < bias.sessions.high
    assert bias.interval.low < 20.0 < bias.interval.high


def test_the_next_recording_has_both_scatters_before_it(tmp_path: Path) -> None:
    paths, table, _ = cohort(tmp_path, 12, 0.0)
    found = pooled(paths, table)
    told = found.following.parameters[0]
    bias = found.spreads[0]
    whole = bias.scatter**2 + bias.sessions.sd**2 + bias.mean_sd**2
    # Twelve devices: larger by no more than Student's 11 / 9 of a variance.
    assert whole < told.sd**2 < 11.0 / 9.0 * whole
    assert found.following.reference == "norm"


def entry_of(path: Path, content: dict) -> Path:
    """As `imucal batch` leaves it, with the calibration beside it."""
    name = content["provenance"]["input"]
    entry = Entry(name, "", 0, 1.0, "", row={}, sums=content.get(KEY))
    write_entry(entry, path, calibration_of(content))
    return path


def folder_of(path: Path, content: dict) -> Path:
    """As `imucal actigraph -o` leaves it."""
    path.mkdir()
    (path / "report.json").write_text(json.dumps(content))
    (path / "calibration.yaml").write_text(to_yaml(calibration_of(content)))
    return path


def calibration_of(content: dict) -> Calibration:
    stored = tuple(
        StoredParameter(
            p["name"],
            p["effect"],
            _STAGES.get(p["effect"], "sensor"),
            p["value"],
            p["sd"],
            p["unit"],
        )
        for p in content["parameters"]
    )
    covariance = np.diag([p["sd"] ** 2 for p in content["parameters"]])
    if len(covariance) == len(BASE):
        covariance = np.array(content["covariance"]["estimated_noise"])
    return Calibration(
        content["calibrator"], stored, covariance, "m/s2", 1.0, 9.8, content["status"],
        triads=tuple(map(triad_from, content.get("triads", ()))),
        facts={"provenance": content["provenance"]},
    )  # fmt: skip


def test_an_entry_says_to_a_fleet_what_its_report_says(tmp_path: Path) -> None:
    content = report("w.csv", device(np.random.default_rng(3)), np.ones(6), 3)
    folder_of(tmp_path / "run", content)
    entry_of(tmp_path / "entries" / "w.json", content)
    by_report, by_entry = (load_calibrations([tmp_path / n])[0][0] for n in ("run", "entries"))
    for name in ("name", "path", "device", "provenance"):
        assert getattr(by_entry, name) == getattr(by_report, name)
    assert [(p.name, p.value, p.sd) for p in by_entry.values] == [
        (p.name, p.value, p.sd) for p in by_report.values
    ]
    assert (by_entry.sums.gram == by_report.sums.gram).all()


@pytest.mark.slow
def test_folders_give_each_device_its_calibration_with_the_fleets_effects(tmp_path: Path) -> None:
    rng, folders = np.random.default_rng(3), []
    for k in range(12):
        content = report(f"w{k}.csv", device(rng), np.r_[2.5, 2.5, 2.5, 0.0, 0.0, 0.0], k)
        folders.append(str(folder_of(tmp_path / f"w{k}", content)))
    out = tmp_path / "fleet"
    done = run("fleet", *folders, "-o", out)
    assert "all devices have temperature bias" in " ".join(done.stdout.split()), done.exception
    stored = read(out / "w3" / "calibration.yaml")
    assert {p.effect for p in stored.parameters} == {*NINE, "temperature_bias"}
    own = [p for p in stored.parameters if p.effect == "temperature_bias"]
    for one, known in zip(own, named("temperature_bias").parameters(Context(1)), strict=True):
        assert abs(one.value - 2.5 * known.typical) < 4.0 * one.sd
        assert one.sd < 1.3 * known.typical  # alone a recording leaves 1.7
    assert stored.facts["fleet"]["effects"] == ["temperature_bias"]
    assert read_population(out / "fleet.yaml").effects == ("temperature_bias",)
    content = json.loads((out / "report.json").read_text())
    assert content["devices"][3]["recordings"][0]["input"] == "w3.csv"
    assert run("validate", out / "w3" / "calibration.yaml").exception is None


def test_the_command_that_corrects_names_a_file_that_is_there(tmp_path: Path) -> None:
    """Also of a device with several recordings, each of which has a folder."""
    _, table, _ = cohort(tmp_path, 4, 0.0)
    out = tmp_path / "fleet"
    run("fleet", tmp_path, "--devices", table, "-o", out, "-q")
    steps = json.loads((out / "report.json").read_text())["card"]["to_do"]
    (command,) = (step for step in steps if "`imucal apply" in step)
    assert Path(command.split("`")[1].split()[2]).is_file()


def test_what_cannot_be_pooled_is_told(tmp_path: Path) -> None:
    paths, table, _ = cohort(tmp_path, 6, 0.0, per=1)
    stored = read(paths[0].with_suffix(".yaml"))
    paths[0].with_suffix(".yaml").write_text(to_yaml(replace(stored, status="weak", sha256="")))
    failed = asdict(Entry("d1_0.csv", "", 4, 0.0, "no rest in it"))
    broken = json.loads(paths[2].read_text())
    broken["sums"]["along"] = ["x"]
    for path, content in zip(paths[1:], (failed, broken), strict=False):
        path.write_text(json.dumps(content))
    found = pooled(paths, table)
    assert len(found.members) == 3
    assert "d0_0" in found.notes[0]
    assert [name for name, _ in found.failed] == ["d1_0.csv", "d2_0.csv"]
    assert "no rest in it" in found.failed[0][1]
    with pytest.raises(UsageError, match="two devices or more"):
        pooled(paths[:4], table)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["one", "one/calibration.yaml"], "the same recording as"),
        (["one", "array"], "of different kinds"),
        (["one", "table.csv"], "is a calibration"),
        (["one", "two", "--columns", "x=B"], "--columns says how to read a table"),
        (["empty", "one"], "no entries of a batch"),
        (["table.csv", "table.csv", "--devices", "table.csv"], "--devices is for calibrations"),
        (["one", "two", "--devices", "table.csv"], "which device made it"),
        (["one", "two", "--devices", "other.csv"], "no device is named for two.csv"),
    ],
)
def test_input_that_makes_no_fleet_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for k, name in enumerate(("one", "two")):
        folder_of(tmp_path / name, report(f"{name}.csv", np.zeros(9), np.zeros(6), k))
    other = report("b.mcap", np.zeros(9), np.zeros(6), 3, kind="array")
    folder_of(tmp_path / "array", other)
    (tmp_path / "empty").mkdir()
    Path("table.csv").write_text("a,b\n1,2\n")
    Path("other.csv").write_text("recording,device\none.csv,x\n")
    done = run("fleet", *arguments)
    assert isinstance(done.exception, UnreadableInput | UsageError)
    assert message in str(done.exception)


def test_boards_are_compared_imu_by_imu(tmp_path: Path) -> None:
    """Reports of arrays hold no products: positions, gains and biases are compared."""
    rng, paths = np.random.default_rng(1), []
    for k in range(6):
        content = report(f"b{k}.mcap", np.zeros(9), np.zeros(6), k, kind="array")
        del content[KEY]
        content["parameters"] = [
            {"name": f"imu1.{a}", "effect": "positions", "value": 20.0 + 0.3 * rng.standard_normal()
             + (9.0 if k == 4 and a == "y" else 0.0), "sd": 0.05, "unit": "mm"} for a in "xyz"
        ]  # fmt: skip
        content["triads"] = [{
            "imu": "imu1", "rotation": np.eye(3).tolist(), "gain": np.eye(3).tolist(),
            "bias_m_per_s2": (0.1 * rng.standard_normal(3)).tolist(),
            "covariance": (1e-8 * np.eye(12)).tolist(), "noise_m_per_s2": 0.04,
            "gyro_gain": np.eye(3).tolist(), "gyro_bias_deg_per_s": [0.0, 0.0, 0.0],
            "gyro_noise_deg_per_s": 0.1,
        }]  # fmt: skip
        paths.append(entry_of(tmp_path / f"b{k}.json", content))
    found = pooled(paths, None)
    assert (found.verdict, found.search, found.following) == ("not searched", None, None)
    assert {o.parameter for o in found.outliers} == {"imu1.y"}
    assert {o.device for o in found.outliers} == {"b4"}
    names = {s.name: s for s in found.spreads}
    assert names["imu1.bias_x"].unit == "mg"
    assert 3.0 < names["imu1.bias_x"].scatter < 30.0


def test_a_recording_with_a_scan_of_its_own_stays_as_it_is(tmp_path: Path) -> None:
    paths, table, _ = cohort(tmp_path, 12, 2.5)
    file = paths[0].with_suffix(".yaml")
    stored, units = read(file), ("x", "y", "z")
    steps = [StoredParameter(f"s_{a}", "bias_step@600s", "sensor", 3.0, 0.1, "mg") for a in units]
    whole = block_diag(stored.covariance, 0.01 * np.eye(3))
    more = replace(stored, parameters=(*stored.parameters, *steps), covariance=whole, sha256="")
    file.write_text(to_yaml(replace(more, valid={"time": (0.0, 1000.0)})))
    found = pooled(paths, table)
    assert found.search.found
    assert found.members[0].recordings[0].kept == "it has bias_step@600s of its own"
    assert not found.members[0].recordings[1].kept
