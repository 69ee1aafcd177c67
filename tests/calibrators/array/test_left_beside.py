"""A name is not certain while what drives it still stands out."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from imucalib.calibrators.array.left_beside import held_against_left
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.loop.found import Step, Unexplained


@dataclass(frozen=True)
class Found:
    steps: tuple[Step, ...]
    unexplained: tuple[Unexplained, ...]
    final: SimpleNamespace


def found(effect: str, left: str, driver: str) -> tuple[str, ...]:
    """Aliases of a certain effect beside what is left."""
    step = Step(effect, 0.002, 499, 90.0, (), ())
    term = SimpleNamespace(name=effect, effect=array_catalogue()[effect.partition("@")[0]])
    unexplained = (Unexplained(left, driver, "probe", 0.002, 50.0, 0.0),)
    loop = Found((step,), unexplained, SimpleNamespace(found=(term,)))
    told = held_against_left(loop).steps[0]  # type: ignore[arg-type]
    assert told.certain == (not told.aliases)
    return told.aliases


@pytest.mark.parametrize(
    ("effect", "left", "driver", "doubt"),
    [
        ("moved_by_rate@imu5", "position of imu5 against time", "imu5", "something else of imu5"),
        ("moved_by_rate@imu5", "position of imu4 against time", "imu4", ""),
        ("moved_by_rate@imu5", "gyro delay of imu5 against time", "imu5", ""),
        ("moved_by_rate", "position of imu5 against time", "imu5", ""),
        ("gyro_bias@imu5", "gyroscope noise of imu5", "imu5", "something else of imu5"),
        (
            "gyro_drift@imu6", "gyroscope error against time", "time",
            "something else that follows time",
        ),
        ("gyro_drift@imu6", "accelerometer error against time", "time", ""),
        ("gyro_scale", "gyroscope error against time", "time", ""),
    ],
)  # fmt: skip
def test_what_drives_it_and_something_that_is_left(
    effect: str, left: str, driver: str, doubt: str
) -> None:
    assert found(effect, left, driver) == ((doubt,) if doubt else ())
