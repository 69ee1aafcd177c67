"""Laws of every command that is_calibrator, found by the shared decorator: one contract for all."""

from __future__ import annotations

import csv
import json
import math
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import jsonschema
import numpy as np
import pytest
from click.testing import Result
from ruamel.yaml import YAML

import imucalib
from imucalib import cli
from imucalib.calibration.outcome import Limit
from imucalib.cli.frame.calibrating import is_calibrator
from imucalib.exports import exports
from imucalib.readers import read
from imucalib.recording.recording import Recording
from imucalib.units import STANDARD_GRAVITY
from worlds.calibrations import INPUTS
from worlds.command import run

SCHEMAS = Path(imucalib.__file__).parent / "schemas"
GROUP = cli.cli
CONTEXT = click.Context(GROUP)
COMMANDS = {
    name: command
    for name in GROUP.list_commands(CONTEXT)
    if (command := GROUP.get_command(CONTEXT, name)) is not None and is_calibrator(command)
}
#: What every calibrating command must offer.
SHARED = {
    "output", "as_json", "quiet", "loop", "curves", "declare", "only", "without",
    "effects_file", "export", "max_error", "gravity", "latitude", "height", "mapping", "acc",
}  # fmt: skip
#: Forms that hold IMUs with gyros, and all that hold an array; every other holds one accelerometer.
OF_IMUS = ("kalibr", "openvins", "ros2-static", "urdf")
OF_ARRAYS = (*OF_IMUS, "c-header", "matlab")
#: Forms whose readers need the walks of the noise, which a bench or a board does not tell.
WITH_WALKS = ("kalibr", "openvins")


def keeps_schema(content: Any, name: str) -> None:
    schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(content, schema)


@dataclass(frozen=True)
class Done:
    """One run of a command on its small input."""

    name: str
    recording: Path
    options: tuple[str, ...]
    out: Path
    result: Result

    @property
    def report(self) -> dict[str, Any]:
        return json.loads((self.out / "report.json").read_text(encoding="utf-8"))

    @property
    def calibration(self) -> Path:
        return self.out / "calibration.yaml"


@pytest.fixture(scope="module", params=sorted(COMMANDS))
def done(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Done:
    name = request.param
    assert name in INPUTS, f"give `{name}` a small input in worlds/calibrations.py"
    folder = tmp_path_factory.mktemp(name)
    given = INPUTS[name](folder)
    arguments = (name, given.recording, *given.options)
    out = folder / "out"
    result = run(*arguments, "-o", out, "--json", "--max-error", "1e9", "--export", "c-header")
    assert result.exception is None, result.output
    return Done(name, given.recording, given.options, out, result)


def test_the_calibrators_are_found() -> None:
    assert set(COMMANDS) == set(INPUTS)


@pytest.mark.slow
def test_reports_and_calibrations_keep_their_schemas(done: Done) -> None:
    keeps_schema(done.report, "report")
    content = YAML(typ="safe", pure=True).load(done.calibration.read_text(encoding="utf-8"))
    keeps_schema(content, "calibration")
    for block in (content, done.report):
        line = shlex.split(block["provenance"]["command"])
        assert line[:3] == ["imucal", done.name, str(done.recording)]
    assert {p.name for p in done.out.iterdir()} == {
        "calibration.yaml", "report.json", "report.html", exports()["c-header"].file
    }  # fmt: skip


@pytest.mark.slow
def test_json_is_pure_and_is_the_report(done: Done) -> None:
    assert json.loads(done.result.stdout) == done.report
    assert done.result.return_value == done.report["exit_code"]
    assert "wrote" in done.result.stderr


@pytest.mark.slow
def test_apply_accepts_it(done: Done, tmp_path: Path) -> None:
    target = tmp_path / "corrected.h5"
    result = run("apply", done.calibration, done.recording, "-o", target, "-q")
    assert result.return_value == 0, result.exception
    before, after = read(done.recording), read(target)
    more = {n for n in after.channels if not n.startswith("fused/")}  # an array's virtual IMU
    assert more == set(before.channels)
    changed = [n for n, c in before.channels.items() if c.quantity == "acceleration"]
    assert changed
    for name in changed:
        raw, corrected = (abs(_at_rest(r, name) - STANDARD_GRAVITY) for r in (before, after))
        assert np.median(corrected) < 0.5 * np.median(raw), name


def _at_rest(recording: Recording, name: str) -> np.ndarray:
    """|a| of second-long means of the samples that hardly move."""
    channel = recording.channels[name]
    per = round(channel.rate)
    rows = len(channel.values) // per
    parts = channel.values[: rows * per].reshape(rows, per, 3)
    still = parts.std(axis=1).max(axis=1)
    return np.linalg.norm(parts.mean(axis=1)[still < 1.5 * np.median(still[: rows // 2])], axis=1)


@pytest.mark.parametrize("form", sorted(exports()))
def test_export_accepts_it_or_says_why_not(done: Done, form: str, tmp_path: Path) -> None:
    content = done.calibration.read_text(encoding="utf-8")
    triads = "\ntriads:" in content
    alone = form not in OF_IMUS or "\nimu:" in content
    if not (form in OF_ARRAYS if triads else alone):
        words = "8 IMUs" if triads else "one accelerometer"
        _refused_export(done, form, tmp_path / "form.txt", words)
    else:
        _accepted_export(done, form, tmp_path / "form.txt")


def _refused_export(done: Done, form: str, target: Path, words: str) -> None:
    result = run("export", done.calibration, "--to", form, "-o", target)
    assert result.return_value == 2
    assert words in str(result.exception)
    assert not target.exists()


def _accepted_export(done: Done, form: str, target: Path) -> None:
    """What loses too much is written by --force, and says the loss with it and without."""
    stated = "\nnoise_density:" in done.calibration.read_text(encoding="utf-8")
    walks = ("--random-walk", "1e-3,1e-5") if form in WITH_WALKS and not stated else ()
    given = ("export", done.calibration, "--to", form, *walks)
    if walks:
        refused = run(*given[:-2], "-o", target)
        assert (refused.return_value, target.exists()) == (2, False)
    result = run(*given, "-o", target)
    told = json.loads(run(*given, "--json", "--force").stdout)
    if result.return_value != 0:
        assert result.return_value == 1, result.exception
        assert f"{told['loss_mg']:.3g} mg" in str(result.exception)
        assert not target.exists()
        result = run(*given, "-o", target, "--force")
    whole = [target] if target.exists() else sorted(target.parent.glob("form-*.txt"))
    texts = [path.read_text(encoding="utf-8") for path in whole]
    assert texts
    assert all(done.recording.name in text and text in told["text"] for text in texts)
    for lost in told["lost"]:
        assert lost in result.stderr
    if form == "c-header":
        assert run(*given, "-q", "--force").stdout == texts[0]
        assert (done.out / exports()[form].file).read_text(encoding="utf-8") == texts[0]


@pytest.mark.slow
def test_batch_and_collect_accept_it(done: Done, tmp_path: Path) -> None:
    manifest, entries, table = tmp_path / "c.txt", tmp_path / "entries", tmp_path / "cohort.csv"
    manifest.write_text(f"{done.recording}\n{tmp_path / 'none.csv'}\n")
    result = run("batch", manifest, "-o", entries, "--calibrator", done.name, "--json", "-q",
                 "--", *done.options)  # fmt: skip
    summary = json.loads(result.stdout)
    assert (summary["calibrated"], len(summary["failed"])) == (1, 1)
    assert run("collect", entries, "-o", table, "--all-columns", "-q").return_value == 0
    with table.open(newline="") as file:
        rows = {Path(r["recording"]).name: r for r in csv.DictReader(file)}
    row, report = rows[done.recording.name], done.report
    assert row["status"] == report["status"]
    assert float(row["held_out_final"]) == pytest.approx(
        report["loop"]["errors"][0]["held_out"]["final"]
    )
    parameter = report["parameters"][0]
    assert float(row[parameter["name"]]) == pytest.approx(parameter["value"])
    assert rows["none.csv"]["status"] == "unreadable"
    assert "cannot be opened" in rows["none.csv"]["why"]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_has_the_shared_options(name: str) -> None:
    own = {p.name for p in COMMANDS[name].params}
    assert own >= SHARED, SHARED - own


def test_an_option_of_two_commands_is_one_option() -> None:
    seen: dict[str, tuple[str, tuple[object, ...]]] = {}
    for name, command in COMMANDS.items():
        for p in command.params:
            if not isinstance(p, click.Option):
                continue
            what = (p.help, repr(p.type), p.default, p.multiple, tuple(p.opts), p.is_flag)
            other, first = seen.setdefault(str(p.name), (name, what))
            assert what == first, f"--{p.name} of {name} and {other}"


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_shows_every_limit(name: str) -> None:
    limits = [p for p in COMMANDS[name].params if str(p.name).startswith("max_")]
    told = [p for p in limits if isinstance(p, click.Option) and str(p.help).startswith("Limit:")]
    assert {p.name for p in limits} - {p.name for p in told} == {"max_chunk"}  # bounds memory


@pytest.mark.slow
def test_a_broken_limit_is_exit_1(done: Done) -> None:
    result = run(done.name, done.recording, *done.options, "--max-error", "1e-9", "--json")
    report = json.loads(result.stdout)
    assert result.return_value == 1
    assert report["status"] == "failed"
    assert [x["broken"] for x in report["limits"]] == [True]


def test_a_value_that_does_not_exist_passes_no_limit() -> None:
    assert Limit("max-error", math.nan, 1e9, "mg").broken
    assert not Limit("max-error", 1.0, 2.0, "mg").broken


@pytest.mark.slow
def test_without_the_loop_nothing_is_searched_and_quiet_is_quiet(done: Done) -> None:
    result = run(done.name, done.recording, *done.options, "--no-loop", "--json")
    report = json.loads(result.stdout)
    keeps_schema(report, "report")
    assert report["loop"]["verdict"] == "not run"
    assert (report["loop"]["steps"], report["loop"]["candidates"]) == ([], [])
    quiet = run(done.name, done.recording, *done.options, "--no-loop", "-q")
    assert (quiet.stdout, quiet.stderr) == ("", "")


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (("--max-error", "nan"), 2),
        (("--gravity", "1"), 2),
        (("--export", "c-header"), 2),
        (("--declare", "aether"), 2),
        (("--effects", "none.py"), 2),
    ],
)
def test_a_wrong_call_is_exit_2_and_json_says_so(
    done: Done, options: tuple[str, ...], code: int
) -> None:
    result = run(done.name, done.recording, *done.options, *options, "--json")
    assert result.return_value == code, result.output
    error = json.loads(result.stdout)["error"]
    assert set(error) == {"message", "where", "remedy", "exit_code"}
    assert error["exit_code"] == code
    assert error["message"]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_failure_is_json_on_stdout_and_words_on_stderr(name: str, tmp_path: Path) -> None:
    given = INPUTS[name](tmp_path)
    arguments = [name, str(tmp_path / "none.csv"), *given.options]
    done = [
        subprocess.run([sys.executable, "-m", "imucalib", *arguments, *more],
                       capture_output=True, text=True, check=False)
        for more in ((), ("--json",))
    ]  # fmt: skip
    assert [d.returncode for d in done] == [3, 3]
    assert done[0].stdout == ""
    words = ["error: " + d.stderr.partition("error: ")[2] for d in done]  # progress is as it may be
    assert words[0] == words[1] != "error: "
    error = json.loads(done[1].stdout)["error"]
    assert error["exit_code"] == 3
    assert error["message"] in done[1].stderr
    assert "none.csv" in error["where"]


@pytest.mark.slow
def test_several_logs_say_where_their_common_report_is(tmp_path: Path) -> None:
    given, out = INPUTS["array"](tmp_path), tmp_path / "out"
    other = given.recording.with_stem("other")
    other.write_bytes(given.recording.read_bytes())
    shown = run("array", given.recording, other, *given.options, "--no-loop", "-o", out)
    assert shown.exception is None, shown.output
    where = f"--full, or {out / 'report.html'}"
    assert "".join(shown.stdout.split()).endswith("".join(where.split()))
    kept = run("array", given.recording, other, *given.options, "--no-loop")
    assert kept.stdout.rstrip().endswith("--full")
