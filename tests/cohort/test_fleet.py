"""A fleet: effects too small for one device, sizes by what the others say, devices of another kind.

Tables by plain numpy: reading = matrix force + bias + q force² + noise (mg).
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.calibration.file import read
from imucalib.calibrators.lab.files import LabFiles
from imucalib.calibrators.lab.request import LabRequest
from imucalib.cohort.fleet.outcome import Fleet, estimate_spreads, outliers
from imucalib.cohort.fleet.run import run_fleet
from imucalib.cohort.fleet.search import PooledDevice, search
from imucalib.errors import UsageError
from worlds.command import run
from worlds.places import SAMPLES

REQUEST = replace(LabRequest(), reference="norm")


def direction(n: int) -> np.ndarray:
    """(n, 3) spread evenly, by the golden angle."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    turn = np.pi * (1.0 + 5.0**0.5) * np.arange(n)
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])


def write(
    path: Path, square: np.ndarray, seed: int, bias: float = 20.0, *, directed: bool = False
) -> Path:
    rng = np.random.default_rng(seed)
    force = direction(24)
    matrix = np.eye(3) + 0.01 * rng.standard_normal((3, 3))
    reading = 1000.0 * force @ matrix.T + bias * rng.standard_normal(3) + square * force**2
    reading = reading + rng.standard_normal((24, 3))
    table, heading = reading, "x (mg),y (mg),z (mg)"
    if directed:
        table, heading = np.hstack([force, reading]), f"ux,uy,uz,{heading}"
    lines = [heading, *(",".join(f"{v:.9g}" for v in row) for row in table)]
    path.write_text("\n".join(lines) + "\n")
    return path


def squares(count: int, size: float) -> np.ndarray:
    return size * (1.0 + 0.3 * np.random.default_rng(3).standard_normal((count, 3)))


def fleet(folder: Path, planted: np.ndarray) -> Fleet:
    paths = [write(folder / f"d{k}.csv", q, 100 + k) for k, q in enumerate(planted)]
    return run_fleet([LabFiles(path) for path in paths], REQUEST, lambda _: None)


@pytest.fixture(scope="module")
def eight(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    return fleet(tmp_path_factory.mktemp("eight"), squares(8, 2.0))


@pytest.mark.slow
def test_what_no_device_shows_alone_is_found_in_all(eight: Fleet) -> None:
    found = eight.search.found[0]
    assert "quadratic" in (found.effect, *found.rivals)
    assert len(found.able) == 8
    assert found.nats.sum() > 3.0
    assert eight.difference.gain > 0.0


@pytest.mark.slow
def test_devices_by_directions_are_a_fleet_too(tmp_path: Path) -> None:
    """Where each row's direction is known, a device has a mounting too, and squares are found."""
    paths = [write(tmp_path / f"d{k}.csv", q, 100 + k, directed=True)
             for k, q in enumerate(squares(4, 6.0))]  # fmt: skip
    request = replace(REQUEST, reference="direction", only=("quadratic",))
    found = run_fleet([LabFiles(p) for p in paths], request, lambda _: None)
    assert [f.effect for f in found.search.found] == ["quadratic"]
    for member, truth in zip(found.members, squares(4, 6.0), strict=True):
        effects = {p.effect for p in member.recordings[0].calibration.parameters}
        assert effects >= {"mounting", "quadratic"}
        own = [p for p in member.recordings[0].calibration.parameters if p.effect == "quadratic"]
        assert all(abs(p.value - q) < 4.5 * p.sd for p, q in zip(own, truth, strict=True))


def test_a_clean_fleet_stays_clean(tmp_path: Path) -> None:
    clean = fleet(tmp_path, np.zeros((6, 3)))
    assert clean.verdict == "nothing found"
    assert clean.exit_code == 0
    assert {m.base for m in clean.members} == {m.final for m in clean.members}


@pytest.mark.slow
def test_a_device_of_another_kind_and_a_bad_table_are_told(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"d{k}.csv", np.zeros(3), k, bias=2.0) for k in range(7)]
    odd = write(tmp_path / "odd.csv", np.zeros(3), 50, bias=400.0)
    bad = tmp_path / "bad.csv"
    bad.write_text("x (mg),y (mg),z (mg)\n1,2,oops\n")
    files = [LabFiles(path) for path in (*paths, odd, bad)]
    found = run_fleet(files, REQUEST, lambda _: None)
    assert {o.device for o in found.outliers} == {"odd"}
    assert [name for name, _ in found.failed] == ["bad"]
    assert "oops" in found.failed[0][1]
    assert found.exit_code == 5
    with pytest.raises(UsageError, match="two devices or more"):
        run_fleet(files[-2:], REQUEST, lambda _: None)


@pytest.mark.slow
def test_five_cave_instruments_have_squares(tmp_path: Path) -> None:
    tables = [SAMPLES / f"cave_{name}.csv" for name in ("ab", "ai", "bi", "fb", "jd")]
    out = tmp_path / "fleet"
    done = run("fleet", *tables, "--reference", "norm", "-o", out)
    headline = " ".join(done.stdout.split())
    assert "Explained: all devices have quadratic or asymmetry" in headline
    page = (out / "report.html").read_text(encoding="utf-8")
    (bias,), (scale,) = (re.findall(rf"<tr>(<td[^>]*>{name}<.*?)</tr>", page, re.DOTALL)
                         for name in ("bias_x", "scale_x"))  # fmt: skip
    words = [re.findall(r"[^\W\d]+", re.sub(r"<[^>]*>", " ", row)) for row in (bias, scale)]
    assert words == [["bias_x", "mg", "mg", "to"], ["scale_x", "to"]]  # a share has no unit
    for name in ("ab", "jd"):
        stored = read(out / f"cave_{name}" / "calibration.yaml")
        assert {p.effect for p in stored.parameters} >= {"bias", "quadratic"}
    again = run("fleet", *tables, "-o", out)
    assert "not empty" in str(again.exception)


def lacking_nothing(rng: np.random.Generator) -> list[PooledDevice]:
    """Five devices with 15 numbers each beside the base model, which six effects' columns span, and
    a noise estimated from the same data."""
    columns, devices = {f"e{k}": np.arange(3 * k, 3 * k + 3) for k in range(6)}, []
    for k in range(5):
        x, y = rng.standard_normal((15, 18)), rng.standard_normal(15)
        y = y / np.sqrt(y @ y / 15.0)
        devices.append(PooledDevice(str(k), 1.0, columns, x.T @ x, x.T @ y, 15.0))
    return devices


@pytest.mark.slow
def test_fleets_that_lack_nothing_claim_nothing() -> None:
    """At most one in fifty."""
    rng = np.random.default_rng(11)
    claims = sum(bool(search(lacking_nothing(rng)).found) for _ in range(400))
    assert claims <= at_most(400, 0.02).most


def test_one_of_five_that_is_off_is_told() -> None:
    """A bias of twenty times the others' scatter was nothing odd, by three degrees of freedom; of
    fleets that lack nothing one in a hundred is told odd, also where axes scatter unlike."""
    rng, sds, names = np.random.default_rng(5), np.full((5, 3), 0.2), [f"bias_{a}" for a in "xyz"]
    told, false = 0, 0
    for _ in range(30):
        size = np.exp(0.5 * rng.standard_normal(3))
        values = size * rng.standard_normal((5, 3)) + 0.2 * rng.standard_normal((5, 3))
        for odd in (False, True):
            values[2, 0] += 20.0 * size[0] * odd
            spreads = estimate_spreads(names, ["mg"] * 3, values, sds, [None] * 3)
            found = outliers(list("abcde"), spreads)
            told += odd and [o.device for o in found] == ["c"]
            false += bool(found) and not odd
    # 3 or more of 30 at 1 %: 0.3 %.
    assert false <= 2
    assert told >= 24
