"""A name is not certain while what drives it still stands out."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.left_beside import held_against_left
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.loop.found import Step, Unexplained

IMUS = tuple(f"imu{k}" for k in range(8))


@dataclass(frozen=True)
class Found:
    steps: tuple[Step, ...]
    unexplained: tuple[Unexplained, ...]
    final: SimpleNamespace


def told(
    effect: str, left: Unexplained, theta: np.ndarray | None = None, noisy: str = "",
    still: float = 1.0,
) -> tuple[str, ...]:  # fmt: skip
    """Aliases of a certain effect of 90 nats beside what is left; noisy : an IMU whose gyro has
    five times the others' noise in motion, and `still` times at rest"""
    family = array_catalogue()[effect.partition("@")[0]]
    step = Step(effect, 0.002, 499, 90.0, (), ())
    own = np.ones(len(family.each) * (1 if family.shared or "@" in effect else 8))
    only = IMUS.index(effect.partition("@")[2]) if "@" in effect else None
    values = own if theta is None else theta
    term = SimpleNamespace(name=effect, effect=family, theta=values, only=only)
    factor, rest = np.ones(8), np.ones(8)
    if noisy:
        factor[IMUS.index(noisy)], rest[IMUS.index(noisy)] = 5.0, still
    final = SimpleNamespace(found=(term,), setup=SimpleNamespace(imus=IMUS))
    loop = Found((step,), (left,), final)
    off, at_rest = (np.ones(8), factor), (np.ones(8), rest)
    doubted = held_against_left(loop, off, at_rest).steps[0]  # type: ignore[arg-type]
    assert doubted.certain == (not doubted.aliases)
    return doubted.aliases


def found(effect: str, left: str, driver: str) -> tuple[str, ...]:
    return told(effect, Unexplained(left, driver, "probe", 0.002, 50.0, 0.0))


LITTLE = Unexplained("gyroscope error against |a|", "|a|", "probe", 0.03, 5.0, 0.0)


@pytest.mark.parametrize("effect", ["accelerometer_misalignment@imu3", "gyro_bias@imu3"])
def test_an_imu_that_is_noisy_in_motion_only_has_more_than_its_names(effect: str) -> None:
    """A chip that tilts with the rate was a certain misalignment of its accelerometer."""
    assert told(effect, LITTLE, noisy="imu3") == ("something else of imu3",)
    assert told(effect, LITTLE, noisy="imu3", still=5.0) == ()
    assert told(effect, LITTLE, noisy="imu4") == ()


def test_an_effect_of_all_that_is_mostly_of_that_imu_is_doubted_too() -> None:
    each = np.full((8, 6), 0.01)
    assert told("accelerometer_misalignment", LITTLE, each.ravel(), "imu3") == ()
    each[3] = 1.0
    doubt = told("accelerometer_misalignment", LITTLE, each.ravel(), "imu3")
    assert doubt == ("something else of imu3",)


@pytest.mark.parametrize(
    ("name", "driver", "nats", "doubted"),
    [
        ("gyroscope noise correlated in time", "time", 574.0, True),
        ("gyroscope noise correlated in time", "time", 57.0, False),
        ("accelerometer noise of imu2", "imu2", 574.0, True),
        ("accelerometer noise of imu5", "imu5", 574.0, False),
        ("at rest: bias against order", "order", 574.0, False),
    ],
)
def test_what_explains_less_than_is_left_is_no_certain_name(
    name: str, driver: str, nats: float, *, doubted: bool
) -> None:
    """A board that bends with the force had certain squares and cross axes of 23 to 348 nats, and
    574 to 953 left."""
    aliases = told("gyro_bias@imu2", Unexplained(name, driver, "noise", 0.002, nats, 0.0))
    assert aliases == (("a part of what is left",) if doubted else ())


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


def test_where_positions_follow_a_drive_no_accelerometer_s_name_is_certain() -> None:
    """One that feels dω/dt was a certain `moved_by_rate`, with positions against |ω| left."""
    for effect, doubt in (
        ("moved_by_rate@imu0", ("something else that positions follow",)),
        ("gyro_bias@imu0", ()),
    ):
        assert found(effect, "positions against |ω|", "|ω|") == doubt
