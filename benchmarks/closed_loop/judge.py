"""One world judged: the command runs on its file as a user's would, and what it says and what its
calibration does to readings that were never recorded is held against the truth."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bench import Table
from numpy.typing import NDArray
from slips import accuses, repaired
from told import Told, corrected, follows, read_corrected, read_report
from world import Attitudes, Bounds, Recipe, World
from worn import Worn

Array = NDArray[np.float64]
NOTHING = Bounds(np.nan, np.nan, np.nan)
SOURCE = Path(__file__).parents[2] / "src"


@dataclass(frozen=True)
class Judged:
    """told : None where there is no report; error : mg rms of the program; response : that apart
    from a walk, where nothing follows it; bounds : of least squares at the truth; held, intervals
    : of 95 % intervals of corrected readings; seconds : of CPU; slip : right, wrong or missed;
    accused : whether any record is said to be wrong"""

    recipe: Recipe
    code: int
    told: Told | None = None
    error: float = np.nan
    response: float = np.nan
    bounds: Bounds = NOTHING
    held: int = 0
    intervals: int = 0
    seconds: float = 0.0
    slip: str = ""
    accused: bool = False
    said: str = field(default="", compare=False)

    @property
    def claims(self) -> bool:
        return self.told is not None and self.told.claims

    @property
    def names(self) -> set[str]:
        """All names that are told, with what could stand in their places."""
        return {n for s in self.told.steps for n in s.names} if self.told else set()

    @property
    def certain(self) -> set[str]:
        """Causes that are told as certain."""
        steps = self.told.steps if self.told else ()
        return {s.names[0] for s in steps if s.certain and s.named}

    @property
    def within(self) -> bool:
        return set(self.recipe.planted) <= self.names

    @property
    def right(self) -> bool:
        """All that is planted is certain, and nothing else."""
        return bool(self.certain) and self.certain == set(self.recipe.planted)

    @property
    def wrong(self) -> bool:
        return bool(self.certain - set(self.recipe.planted)) or (
            self.recipe.outside and bool(self.certain)
        )

    @property
    def over_oracle(self) -> float:
        return self.error / self.bounds.oracle

    @property
    def over_base(self) -> float:
        return self.error / self.bounds.base

    @property
    def over_response(self) -> float:
        return self.response / self.bounds.response


def made(recipe: Recipe) -> World:
    """The world of a recipe. Raises NoSuchWorld where its strength is out of credible reach."""
    return Worn(recipe) if recipe.kind == "worn" else Table(recipe)


def judge(recipe: Recipe) -> Judged:
    """Make the world, run the command on it, and judge."""
    return judged(made(recipe))


def judged(world: World) -> Judged:
    """Run the command on a world's file, and judge."""
    seen = world.attitudes()
    found: dict[str, Any] = {"bounds": world.errors(seen)}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        code, seconds, said = ran([*world.write(folder), "-o", str(folder / "out")])
        told = None
        if (folder / "out" / "report.json").is_file():
            told = read_report(folder / "out")
        if (folder / "out" / "calibration.yaml").is_file():
            found |= errors(world, seen, folder)
    # A table that is refused names the slip in its error.
    lines = list(told.lines) if told else [said]
    slip = ""
    if world.recipe.slip:
        slip = "missed"
        if accuses(lines):
            slip = "right" if repaired(world.repair, lines) else "wrong"
    return Judged(
        world.recipe,
        code,
        told,
        seconds=seconds,
        slip=slip,
        accused=accuses(lines),
        said=said,
        **found,
    )


def errors(world: World, seen: Attitudes, folder: Path) -> dict[str, float | int]:
    """The calibration against the truth: mg rms, and how many of its intervals hold."""
    value, spread = corrected(folder / "out", seen.reading, seen.covariates)
    if isinstance(world, Worn):  # the command knows what the clock and the thermometer tell
        arguments, out = world.corrected_by(folder)
        ran(arguments)
        value = world.picked(read_corrected(out))
    if world.recipe.kind == "bench":
        away = value - 1000.0 * seen.force
        half = 1.96 * np.sqrt(np.einsum("nii->ni", spread))
        return {
            "error": world.force_error(away, seen.force),
            "held": int(np.sum(np.abs(away) <= half)),
            "intervals": away.size,
        }
    # Of a norm the frame is a convention: the size is judged alone.
    size = np.linalg.norm(value, axis=1)
    still, response = size, np.nan
    if isinstance(world, Worn) and not follows(folder / "out"):
        # Parameters do not speak of a walk that nothing follows, nor do their intervals.
        alone, spread = corrected(folder / "out", seen.reading - seen.walk, seen.covariates)
        still = np.linalg.norm(alone, axis=1)
        response = float(np.sqrt(np.mean((still - 1000.0) ** 2)))
    along = value / size[:, None]
    half = 1.96 * np.sqrt(np.einsum("ni,nij,nj->n", along, spread, along))
    return {
        "error": float(np.sqrt(np.mean((size - 1000.0) ** 2))),
        "response": response,
        "held": int(np.sum(np.abs(still - 1000.0) <= half)),
        "intervals": size.size,
    }


def ran(arguments: list[str]) -> tuple[int, float, str]:
    """Exit code, CPU seconds and what the command says on its error stream."""
    command = [sys.executable, "-m", "imucalib", *arguments, "--json", "--force", "--quiet"]
    path = os.pathsep.join([str(SOURCE), os.environ.get("PYTHONPATH", "")])
    before = os.times()
    done = subprocess.run(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"},
    )
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user
    return done.returncode, spent - before.children_system, done.stderr.strip()[-300:]
