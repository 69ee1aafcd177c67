"""No byte of a name becomes code in any form: it is refused when the calibration is read, or it
stays inside a string, a comment or a cell."""

from __future__ import annotations

import copy
import csv
import io
import re
import shlex
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import as_dict, from_dict, read, to_yaml
from imucalib.errors import UnreadableInput, UsageError
from imucalib.exports import export, exports
from imucalib.exports.imus import state_walks
from worlds.rigid_board import board, calibration

EVIL = (
    "a*/ int evil; /*",
    'a"; int evil; //',
    "a'}; evil; y={'",
    "a\n#define evil 1\nint evil;",
    "a\r\nevil = 1;",
    "a --> <evil/> <!-- ",
    "a --frame-id evil",
    "=evil()",
    "a\\",
    "a\u2028evil;",
)
#: Names that people give.
SOUND = ("imu_0", "imu-1.front", "/robot/imu_fl/data_raw", "Cámara 2", "IMU #3 (spare)", "加速度計")


def _leaves(block: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], str]]:
    """Every text below a block, with the way to it."""
    items = block.items() if isinstance(block, dict) else enumerate(block)
    for key, value in items:
        if isinstance(value, dict | list):
            yield from _leaves(value, (*path, key))
        elif isinstance(value, str):
            yield (*path, key), value


def _put(block: Any, path: tuple[Any, ...], text: str) -> Any:
    changed = copy.deepcopy(block)
    inner = changed
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = text
    return changed


def _renamed(made: Any, old: str, new: str) -> Any:
    """The content with a sensor's name exchanged wherever it stands."""
    if isinstance(made, dict):
        return {k.replace(old, new): _renamed(v, old, new) for k, v in made.items()}
    if isinstance(made, list):
        return [_renamed(v, old, new) for v in made]
    return made.replace(old, new) if isinstance(made, str) else made


@pytest.fixture(scope="module")
def content() -> dict[str, Any]:
    return as_dict(calibration(board(np.random.default_rng(2), chips=2)))


def _code_of(file: str, text: str) -> str:
    """What is left of a file without its comments, strings and cells."""
    if file.endswith(".h"):
        text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        return re.sub(r'"[^"\n\\]*"', "", text)
    if file.endswith(".m"):
        return re.sub(r"'(?:[^'\n]|'')*'", "", re.sub(r"%.*", "", text))
    if file.endswith((".xml", ".urdf")):
        arguments = [n.get("args", "") for n in ET.fromstring(text).iter("node")]
        tags = " ".join(e.tag for e in ET.fromstring(text).iter())
        return tags + " ".join(w for a in arguments for w in shlex.split(a) if w == "evil")
    if file.endswith((".yaml", ".yml")):
        YAML(typ="safe", pure=True).load(text.replace("%YAML:1.0", ""))
        return ""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    if file.endswith(".csv"):
        cells = [cell for row in csv.reader(io.StringIO("\n".join(lines))) for cell in row]
        return " ".join(cell for cell in cells if cell.startswith(tuple("=+@\t\r")))
    return "\n".join(lines)


def _made(loaded: Calibration, source: str = "log.csv") -> Iterator[tuple[str, str]]:
    facts = {"sample_interval_s": 0.01, **loaded.facts}
    noisy = state_walks(replace(loaded, facts=facts), 1e-3, 2e-5)
    for form in exports().values():
        try:
            made = export(noisy, source, form.name)
        except (UsageError, UnreadableInput):  # it cannot hold such a calibration
            continue
        for text in made.files.values() or (made.text,):
            yield made.file, text


@pytest.mark.parametrize("evil", EVIL)
def test_no_text_of_a_calibration_is_code(content: dict[str, Any], evil: str) -> None:
    refused = 0
    for path, _ in _leaves(content):
        if path[0] in ("schema", "formula"):
            continue
        try:
            loaded = from_dict(_put(content, path, evil), "c.yaml")
        except UnreadableInput:
            refused += 1
            continue
        for file, text in _made(loaded):
            assert "evil" not in _code_of(file, text), (path, file)
    assert refused or evil in HARMLESS


#: Which are names as good as others.
HARMLESS = ("a --frame-id evil", "=evil()")


@pytest.mark.parametrize("evil", [e for e in EVIL if e not in HARMLESS])
def test_no_name_of_a_sensor_is_read_that_may_be_code(content: dict[str, Any], evil: str) -> None:
    with pytest.raises(UnreadableInput, match="is no name"):
        from_dict(_renamed(content, "imu0", evil), "c.yaml")


@pytest.mark.parametrize("evil", HARMLESS)
def test_no_name_of_a_sensor_is_code(content: dict[str, Any], evil: str) -> None:
    for file, text in _made(from_dict(_renamed(content, "imu0", evil), "c.yaml")):
        assert "evil" not in _code_of(file, text), file


@pytest.mark.parametrize("evil", EVIL)
def test_no_name_of_a_file_is_code(content: dict[str, Any], evil: str, tmp_path: Path) -> None:
    loaded = from_dict(content, "c.yaml")
    for file, text in _made(loaded, f"{evil}.csv"):
        assert "evil" not in _code_of(file, text), file
        if file.endswith(".h") and shutil.which("gcc"):
            (tmp_path / "a.c").write_text(f"{text}\nint evil;\nint main(void) {{ return 0; }}\n")
            subprocess.run(["gcc", "-Wall", "a.c"], cwd=tmp_path, check=True, capture_output=True)


@pytest.mark.parametrize("name", SOUND)
def test_names_that_people_give_are_read_and_exported(
    content: dict[str, Any], name: str, tmp_path: Path
) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(to_yaml(from_dict(_renamed(content, "imu0", name), "")), encoding="utf-8")
    assert read(path).triads[0].name == name
    assert len(list(_made(read(path)))) >= 6
