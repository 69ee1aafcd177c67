"""A finished run is finished: nothing of it is made twice, and its files come all or none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.calibration.file import write_together
from imucalib.errors import UsageError
from worlds.calibrations import INPUTS

#: Function -> modules that call it by name.
MADE = {
    "lab_calibration": "imucalib.calibrators.lab.run",
    "actigraph_calibration": "imucalib.calibrators.actigraph.run",
    "array_calibration": "imucalib.calibrators.array.run",
    "imu_calibration": "imucalib.calibrators.imu.run",
    "coverage_of": "imucalib.calibrators.actigraph.run",
    "linear_part": "imucalib.calibrators.array.calibrate",
    "lab_document": "imucalib.report.lab",
    "actigraph_document": "imucalib.report.actigraph",
    "array_document": "imucalib.report.array",
    "imu_document": "imucalib.report.imu",
    "report_dict": "imucalib.report.files",
    "matrices": "imucalib.calibration.calibration",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(INPUTS))
def test_everything_is_made_once(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import importlib

    calls: Counter[str] = Counter()

    def counted(what: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def count(*args: Any, **options: Any) -> Any:
            calls[what] += 1
            return function(*args, **options)

        return count

    for what, where in MADE.items():
        module = importlib.import_module(where)
        monkeypatch.setattr(module, what, counted(what, getattr(module, what)))
    given = INPUTS[name](tmp_path)
    arguments = [name, str(given.recording), *given.options]
    for output in ("--json", "-v"):
        calls.clear()
        more = [output] if output == "--json" else []
        result = CliRunner().invoke(
            cli.cli, [*arguments, "-o", str(tmp_path / "out"), *more], standalone_mode=False
        )
        assert result.exception is None, result.output
        own = {n for n in MADE if n.startswith(name)} | {"report_dict"}
        own |= {"lab": {"matrices"}, "actigraph": {"matrices", "coverage_of"},
                "imu": {"matrices", "lab_calibration"}, "array": {"linear_part"}}[name]  # fmt: skip
        assert dict(calls) == dict.fromkeys(own, 1)


def test_files_come_all_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = {tmp_path / n: "old" for n in ("a", "b", "c")}
    write_together(old)
    write = Path.write_text

    def full(self: Path, text: str, **options: Any) -> int:
        if text == "full":
            raise OSError(28, "No space left on device")
        return write(self, text, **options)

    monkeypatch.setattr(Path, "write_text", full)
    texts = list(zip("abc", ("new", "full", "new"), strict=True))
    with pytest.raises(UsageError, match="No space left"):
        write_together({tmp_path / n: t for n, t in texts})
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == dict.fromkeys("abc", "old")
