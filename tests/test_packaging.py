"""What the packaging names is there: the Dockerfile's lines, what it may see, what it starts."""

from __future__ import annotations

import re
import shlex
import tomllib
from fnmatch import fnmatch
from pathlib import Path

from imucalib.recording.yaml_text import load

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def dockerfile() -> list[tuple[str, str]]:
    """(instruction, rest) of every line, continued lines joined."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in lines)]


def copied() -> list[str]:
    """What the image is built from."""
    from_context = [shlex.split(rest)[:-1] for word, rest in dockerfile()
                    if word == "COPY" and "--from" not in rest]  # fmt: skip
    return [name for names in from_context for name in names]


def test_the_image_is_built_from_what_there_is() -> None:
    seen = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines()
            if line.startswith("!")]  # fmt: skip
    assert sorted(copied()) == sorted(seen)
    for name in copied():
        assert (ROOT / name).exists(), name


def test_the_image_holds_all_that_the_build_needs() -> None:
    needed = {"pyproject.toml", PROJECT["readme"], *PROJECT["license-files"], "src"}
    assert needed <= set(copied())


def test_the_image_starts_the_command_on_a_python_that_is_tested() -> None:
    lines = dockerfile()
    (start,) = [rest for word, rest in lines if word == "ENTRYPOINT"]
    assert start == f'["{next(iter(PROJECT["scripts"]))}"]'
    matrix = re.search(r"python: \[(.*)\]", (ROOT / ".github/workflows/ci.yml").read_text())
    assert matrix
    tested = re.findall(r'"([\d.]+)"', matrix[1])
    for base in (rest.split()[0] for word, rest in lines if word == "FROM"):
        found = re.fullmatch(r"python:([\d.]+)-slim", base)
        assert found, base
        assert found[1] in tested


def test_what_the_image_drops_is_no_part_of_the_program() -> None:
    (run,) = [rest for word, rest in dockerfile() if word == "RUN"]
    dropped = re.search(r"-name (\S+) -prune", run)
    assert dropped
    folders = [p.name for p in (ROOT / "src").rglob("*") if p.is_dir()]
    assert folders
    assert not [name for name in folders if fnmatch(name, dropped[1])]


def test_the_conda_recipe_states_what_the_package_states() -> None:
    recipe = load(ROOT / ".ci" / "conda" / "recipe.yaml")
    stated = {
        re.split(r"[>;]", one)[0].replace("lz4", "python-lz4"): re.findall(r">=([\d.]+)", one)[0]
        for one in PROJECT["dependencies"]
    } | {"python": PROJECT["requires-python"].removeprefix(">=")}
    run = (line.split(" >=") for line in recipe["requirements"]["run"])
    assert {name: version for name, version in run} == stated
    assert recipe["context"]["version"] == PROJECT["version"]


def test_the_tests_run_on_every_platform_that_is_promised() -> None:
    jobs = load(ROOT / ".github" / "workflows" / "ci.yml")["jobs"]
    assert jobs["run"]["runs-on"] == "ubuntu-latest"
    assert jobs["platforms"]["strategy"]["matrix"]["os"] == ["macos-latest", "windows-latest"]
    pythons = jobs["run"]["strategy"]["matrix"]["python"]
    assert pythons[0] == PROJECT["requires-python"].removeprefix(">=")
