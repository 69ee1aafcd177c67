"""Options in a file, and a calibrator that another package adds."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner, Result
from ruamel.yaml import YAML

import imucalib
from imucalib import cli
from imucalib.calibration.calibration import from_fit
from imucalib.calibration.findings import findings_of
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Limit, Outcome, Run
from imucalib.calibration.provenance import provenance_of
from imucalib.cli.calibrating import calibrating, finish, shared_of
from imucalib.cohort.entries import Entry, rows
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.core.sphere import even_directions
from imucalib.effects import catalogue, named
from imucalib.loop.candidates import Searched
from imucalib.loop.held_out import Held, fitted, held_out
from imucalib.loop.posterior.closed import close_loop
from imucalib.report.files import Report
from imucalib.report.sections import standard_document
from imucalib.units import MG
from worlds.command import run
from worlds.places import SAMPLES

CAVE = SAMPLES / "cave_ai.csv"


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path / "imucal.toml"


def lab(*arguments: str) -> Result:
    words = ["lab", str(CAVE), "--json", "-q", *arguments]
    return CliRunner().invoke(cli.cli, words, standalone_mode=False)


def test_options_of_the_file_are_defaults_and_typed_ones_win(bench: Path) -> None:
    bench.write_text('[lab]\nreference = "norm"\nno-loop = true\ngravity = 9.81\n')
    refused = lab()
    assert isinstance(refused.exception, click.UsageError)  # loop = false is the name
    bench.write_text(
        '[lab]\nreference = "norm"\nloop = false\ngravity = 9.81\nexclude = "1,2"\n'
        '[actigraph]\nlatitude = 46.3\n'
    )  # fmt: skip
    settings = json.loads(lab().stdout)["provenance"]["settings"]
    assert settings["gravity_m_per_s2"] == 9.81
    assert settings["exclude"] == [1, 2]
    assert settings["loop"] is False
    typed = json.loads(lab("--gravity", "9.79").stdout)["provenance"]
    assert typed["settings"]["gravity_m_per_s2"] == 9.79


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[lab]\ngravty = 9.8\n", "'gravty' is no option of imucal lab"),
        ("gravity = 9.8\n", "stands in no section"),
        ("[labb]\ngravity = 9.8\n", "no command 'labb'"),
        ('[lab]\neffects = "own.py"\n', "'effects' must be typed"),
        ('[lab]\noutput = "out"\n', "'output' must be typed"),
        ("[lab\n", "imucal.toml"),
        ('[lab]\nreference = "norm"\ngravity = "much"\n', "much"),
    ],
)
def test_what_is_wrong_in_it_is_said(bench: Path, text: str, words: str) -> None:
    bench.write_text(text)
    done = lab()
    assert isinstance(done.exception, click.UsageError)
    assert words in done.exception.format_message()


SCHEMAS = Path(imucalib.__file__).parent / "schemas"


def toy_run(path: Path, asked: dict[str, Any]) -> Run:
    """The library's part: readings at rest (x, y, z in m/s²) against the size of gravity."""
    reading = np.loadtxt(path, delimiter=",", skiprows=1)
    n = len(reading)
    data = Observations(
        reading[:, None], np.full((n, 1, 3), MG), KnownNorm(n, asked["gravity"]),
        Context(n, {"order": np.linspace(0.0, 1.0, n)}), np.arange(n),
        tuple(f"rest {k}" for k in range(n)),
    )  # fmt: skip
    model = Model(tuple(named(name) for name in ("bias", "scale", "non_orthogonality")))
    effects = {n: e for n, e in catalogue().items() if e.stage == "sensor"}
    loop = close_loop(model, data, Searched(effects, ())).loop
    base, final = loop.plain, loop.as_recorded
    raw = _raw(data, asked)
    out = [_mg(held_out(f)) for f in (base, final)]
    error = ErrorSummary(
        metric="error of |a|, rms",
        unit="mg",
        raw=raw,
        base=_mg(fitted(base)),
        final=_mg(fitted(final)),
        floor=1.0,
        held_out=HeldOutError(raw, *out),
    )
    outcome = Outcome(
        calibrator="toy",
        errors=(error,),
        provenance=provenance_of(path=str(path), sha256="", samples=n, mapping={}, settings={},
                                 seed=asked["seed"], command=asked["command"]),
        findings=findings_of(loop),
        fit=final,
        limits=tuple(Limit(k, out[1], v, "mg") for k, v in asked["limits"].items()),
    )  # fmt: skip
    calibration = from_fit(
        final, "toy", raw_unit="m/s2", raw_to_si=1.0, gravity=asked["gravity"],
        status=outcome.status, reasons=outcome.reasons,
        facts={"errors": [error.as_dict()], "provenance": outcome.provenance.as_dict()},
    )  # fmt: skip
    return Run(outcome=outcome, calibration=calibration)


def _mg(held: Held) -> float:
    return held.rms() / MG


def _raw(data: Observations, asked: dict[str, Any]) -> float:
    size = np.linalg.norm(data.reading[:, 0], axis=1)
    return float(np.sqrt(np.mean((size - asked["gravity"]) ** 2))) / MG


@click.command("toy")
@click.argument("table", type=click.Path(path_type=Path))
@calibrating
def command(table: Path, **options: Any) -> int:
    """The command's part."""
    run = toy_run(table, shared_of(options))
    return finish([Report(run, standard_document(run))], options)


@pytest.fixture
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    module = ModuleType("imucalib.cli.toy")
    module.command = command  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "imucalib.cli.toy", module)
    monkeypatch.setitem(cli.COMMANDS, "toy", "A toy.")
    rng = np.random.default_rng(0)
    force = 9.80665 * even_directions(40)
    reading = force * [1.01, 0.99, 1.02] + 0.02 + 3e-3 * force**2 + 1e-2 * rng.normal(size=(40, 3))
    path = tmp_path / "toy.csv"
    np.savetxt(path, reading, delimiter=",", header="x,y,z", comments="")
    return path


def test_everything_else_comes_by_itself(table: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run("toy", table, "-o", out, "--json", "--export", "ggir-csv", "--force")
    assert result.exception is None, result.exception
    report = json.loads(result.stdout)
    content = YAML(typ="safe", pure=True).load((out / "calibration.yaml").read_text())
    for name, block in (("report", report), ("calibration", content)):
        schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))
        jsonschema.validate(block, schema)
    assert result.return_value == report["exit_code"]
    found = {n for s in report["loop"]["steps"] for n in (s["effect"], *s["aliases"])}
    assert "quadratic" in found
    assert "quadratic" in (out / "report.html").read_text(encoding="utf-8")
    held = report["loop"]["errors"][0]["held_out"]
    assert held["final"] < 0.5 * held["base"]
    assert " (in cal.error.end): " in result.stderr
    assert run("validate", out / "calibration.yaml").return_value == 0
    header = run("export", out / "calibration.yaml", "--to", "c-header", "--force")
    assert header.return_value == 0
    assert "quadratic" in header.stderr
    (row,) = rows((Entry("toy.csv", "", 0, 1.0, "", report),))
    assert row["bias_x"] == report["parameters"][0]["value"]
