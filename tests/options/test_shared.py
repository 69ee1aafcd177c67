"""Options that many commands have: one law for all that have them, found in the command tree."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import NoReturn

import pytest

from imucalib import readers
from imucalib.cli import calibrators
from imucalib.errors import UnreadableInput
from imucalib.recording.mapping import FieldMapping
from options.bench import Bench
from options.case import USUAL
from options.listed import reading
from options.outcome import Outcome, run
from options.schemas import keep_schema
from options.tree import commands, options_of

Pair = tuple[Outcome, Outcome]


def having(option: str) -> pytest.MarkDecorator:
    names = [name for name, command in commands().items() if option in options_of(command)]
    return pytest.mark.parametrize("name", [pytest.param(n, id=n.replace(" ", "-")) for n in names])


def with_and_without(bench: Bench, name: str, option: str, *more: str) -> Pair:
    """The usual call without any word about what is printed, and with one."""
    plain = [a for a in (*USUAL[name], *more) if a not in ("--json", "--quiet")]
    at = plain.index("--") if "--" in plain else len(plain)
    return bench.run(plain), bench.run([*plain[:at], option, *plain[at:]])


def bare(outcome: Outcome) -> dict[str, bytes]:
    """Files without what says where and when they were made."""
    out = {}
    for name, data in outcome.files.items():
        plain = data.replace(str(outcome.folder).encode(), b"")
        plain = re.sub(rb'"(seconds|command|time)": ?[^,\n]*|--json ?|--quiet ?|-q ?', b"", plain)
        out[name] = re.sub(rb"(?m)^(# imucal calibration|  (time|command): ).*$", b"", plain)
    return out


@pytest.mark.slow
@having("--json")
def test_json_is_the_result_and_changes_no_file(name: str, bench: Bench) -> None:
    plain, done = with_and_without(bench, name, "--json")
    assert done.code == plain.code
    assert json.loads(done.stdout)
    assert not plain.stdout.lstrip().startswith(("{", "["))
    assert bare(done).keys() == bare(plain).keys()
    binary = (".h5", ".mcap")  # they keep the time at which they were written
    for file, data in bare(plain).items():
        assert file.endswith(binary) or bare(done)[file] == data, file


@having("--json")
def test_json_keeps_its_schema(name: str, bench: Bench) -> None:
    """A result, and what is printed in place of one."""
    plain = [a for a in USUAL[name] if a != "--json"]
    at = plain.index("--") if "--" in plain else len(plain)
    typed = [*plain[:at], "--json", *plain[at:]]
    keep_schema(json.loads(bench.run(typed).stdout))


@pytest.mark.slow
@having("--quiet")
def test_quiet_prints_nothing_and_changes_no_file(name: str, bench: Bench) -> None:
    into = ("-o", "<out>/form.h") if name == "export" else ()
    plain, done = with_and_without(bench, name, "--quiet", *into)
    assert done.code == plain.code
    assert plain.stdout
    assert (done.stdout, done.stderr) == ("", "")
    assert bare(done).keys() == bare(plain).keys()


#: The option that names an output, where it is not part of the usual call.
OUTPUTS: dict[str, tuple[tuple[str, ...], ...]] = {
    **dict.fromkeys(calibrators(), (("-o", "<out>/made"),)),
    "check": (("--html", "<out>/made"),),
    "compare": (("--html", "<out>/made"),),
    "design": (("-o", "<out>/made"),),
    "fleet": (("-o", "<out>/made"),),
    "inspect": (("--save-mapping", "<out>/made"), ("--html", "<out>/made")),
    "noise": (("--to", "ros", "-o", "<out>/made"), ("--html", "<out>/made")),
    "export": (("-o", "<out>/made"),),
    "apply": ((),),
    "convert": ((),),
    "collect": ((),),
    "simulate lab": ((), ("--recording", "<out>/made.csv")),
    "simulate actigraph": ((),),
    "simulate array": ((),),
    "simulate imu": ((),),
}


@pytest.mark.parametrize("name", [pytest.param(n, id=n.replace(" ", "-")) for n in commands()])
def test_a_command_that_writes_has_force(name: str, bench: Bench) -> None:
    """All but batch, whose entries say what they were made of and are kept or made by that."""
    options = options_of(commands()[name])
    writes = "--output" in options or bool(bench.run(USUAL[name]).files)
    assert ("--force" in options) == (name in OUTPUTS)
    assert name in OUTPUTS or name == "batch" or not writes


@having("--force")
def test_another_file_is_replaced_by_force_alone(name: str, bench: Bench, tmp_path: Path) -> None:
    assert name in OUTPUTS, f"say in OUTPUTS which option of `{name}` names its output"
    for k, option in enumerate(OUTPUTS[name]):
        folder = tmp_path / str(k)
        words = [a.replace("<out>", str(folder)) for a in (*USUAL[name], *option)]
        typed = [re.sub(r"<([^<>]+)>", lambda m: str(bench.path(m[1])), a) for a in words]
        target = Path(next(a for a in reversed(typed) if a.startswith(str(folder))))
        if name in (*calibrators(), "fleet"):
            target.mkdir(parents=True)
            target = target / ("report.json" if name == "fleet" else "calibration.yaml")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(b"another's work")
        assert run(typed, folder).code == 2
        assert target.read_bytes() == b"another's work"
        assert run([*typed, "--force"], folder).code in (0, 5)
        assert target.read_bytes() != b"another's work"


VALUES: dict[str, tuple[str, object]] = {
    "--sensor": ("aux", "aux"),
    "--acc": ("a,b,c", ("a", "b", "c")),
    "--gyro": ("a,b,c", ("a", "b", "c")),
    "--temperature": ("warm", ("warm",)),
    "--time": ("stamp", "stamp"),
    "--unit": ("ug", "ug"),
    "--lsb": ("17", (17.0,)),
    "--gyro-unit": ("deg/s", "deg/s"),
    "--gyro-lsb": ("18", (18.0,)),
    "--time-unit": ("us", "us"),
    "--rate": ("19", 19.0),
    "--axis-map": ("y,z,x", "y,z,x"),
    "--preset": ("euroc", "euroc"),
    "--acc-offset": ("20", (20.0,)),
    "--skip": ("21", 21),
    "--decimal": (",", ","),
    "--max-chunk": ("22", 22),
    "--allow-external": ("", True),
    "--delimiter": (";", ";"),
    "--temperature-unit": ("K", "K"),
    "--time-format": ("%d/%m/%Y", "%d/%m/%Y"),
    "--where": ("tool=A12", ("tool=A12",)),
}
FIELDS = {"unit": "acc_unit", "lsb": "lsb_per_g", "gyro_lsb": "lsb_per_dps"}
#: A recording where the usual call has a table.
READS = {
    "check": ("check", "<calibration.yaml>", "<rests.csv>", "--json"),
    "fleet": ("fleet", "<rests.csv>", "<rests2.csv>", "--reference", "norm", "--json"),
    "inspect": ("inspect", "<rests.csv>", "--rests", "--json"),
    "lab": ("lab", "<rests.csv>", "--reference", "norm", "--no-loop", "--json"),
}


class Stopped(UnreadableInput):
    """Raised where a reader starts."""


@having("--mapping")
def test_the_reader_is_told(name: str, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each option of the block, and the mapping file, arrive where files are read."""
    told: list[FieldMapping] = []

    def stop(mapping: FieldMapping) -> NoReturn:
        told.append(mapping)
        raise Stopped("stopped")

    plain = READS.get(name, USUAL[name])
    words = [re.sub(r"<(?!out)([^<>]+)>", lambda m: str(bench.path(m[1])), a) for a in plain]
    monkeypatch.setattr(readers, "with_preset", stop)
    assert set(reading()) == {*VALUES, "--mapping"}
    for k, (option, (text, value)) in enumerate(VALUES.items()):
        folder = bench.folder / f"told-{name}-{k}"
        typed = [a.replace("<out>", str(folder)) for a in words]
        run([*typed, option, *([text] if text else [])], folder)
        key = option.removeprefix("--").replace("-", "_")
        if option != "--sensor" or name not in ("apply", "check"):  # which read all of them
            assert getattr(told[-1], FIELDS.get(key, key)) == value, option
    mapping = bench.path("counts.yaml")
    folder = bench.folder / f"told-{name}"
    run([*(a.replace("<out>", str(folder)) for a in words), "--mapping", str(mapping)], folder)
    assert told[-1].lsb_per_g == (256.0,)
    assert len(told) % (len(VALUES) + 1) == 0  # a fleet has more than one table
