"""How a bench's errors are judged: angles, floors, limits and what is advised, by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.lab import advice
from imucalib.calibrators.lab.attitude import attitude_errors
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.errors import noise_floor
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.errors import UsageError
from imucalib.loop.held_out import Held
from imucalib.units import DEG, MG
from worlds.sheets import direction

G = 9.80665


def errors_of(
    meant: tuple[float, float], read: tuple[float, float], size: float = G
) -> list[float]:
    """Inclination and tool-face (deg) and norm (mg) of one position."""
    one, other = (np.array([[direction(*map(np.array, a))]]) for a in (read, meant))
    found = attitude_errors(Held(size * one, G * other, size * one - G * other), Conventions())
    return [float(found.inclination[0]), float(found.tool_face[0]), float(found.norm[0])]


@pytest.mark.parametrize(
    ("meant", "read", "inclination", "tool_face"),
    [
        ((10.0, 20.0), (10.5, 20.0), 0.5, 0.0),
        ((10.0, 20.0), (10.0, 19.0), 0.0, -1.0),
        ((0.0, 0.5), (0.0, 359.5), 0.0, -1.0),  # across the turn
        ((0.0, 359.5), (0.0, 0.5), 0.0, 1.0),
        ((85.0, 30.0), (91.0, 30.0), 6.0, 0.0),  # 91 is not read as 89 of the other side
        ((-85.0, 30.0), (-92.0, 31.0), -7.0, 1.0),
        ((40.0, 10.0), (40.0, 110.0), 0.0, 100.0),  # a flat tool is turned, not folded
        ((-60.0, 200.0), (-59.0, 198.0), 1.0, -2.0),
    ],
)
def test_angles_are_compared_on_vectors(
    meant: tuple[float, float], read: tuple[float, float], inclination: float, tool_face: float
) -> None:
    assert errors_of(meant, read) == pytest.approx([inclination, tool_face, 0.0], abs=1e-9)


def test_the_size_is_compared_with_what_a_swing_of_the_bench_makes_of_gravity() -> None:
    one = G * direction(np.array(10.0), np.array(20.0))[None, None]
    found = attitude_errors(Held(1.004 * one, 1.003 * one, 0.001 * one), Conventions())
    assert found.norm[0] == pytest.approx(1.0)


def test_tool_face_means_nothing_within_three_degrees_of_the_vertical() -> None:
    assert np.isnan(errors_of((87.2, 0.0), (87.2, 5.0))[1])
    assert errors_of((87.1, 0.0), (87.1, 5.0))[1] == pytest.approx(5.0)
    assert np.isnan(errors_of((-88.0, 0.0), (-88.0, 5.0))[1])


def repeated(pairs: int, apart: float) -> Observations:
    """Attitudes that are taken twice, in mixed order, whose readings differ by 1, 2 and 2 times
    `apart`; and as many that are taken once."""
    place = np.array([*range(pairs), *range(pairs), *range(pairs, 2 * pairs)])
    i, t = 3.0 * place - 40.0, 11.0 * place
    reading = G * direction(i, t)
    reading[pairs : 2 * pairs] += apart * np.array([1.0, 2.0, 2.0])
    ids = np.arange(len(place))
    reference = KnownVector(np.radians(i), np.radians(t), G, ids, ids)
    names = tuple(map(str, ids))
    return Observations(reading[:, None], np.ones((len(ids), 1, 3)), reference, Context(len(ids)),
                        ids, names)  # fmt: skip


def test_the_floor_is_that_of_six_repeats_or_more() -> None:
    """Differences of two readings scatter by √2; 1.4826 makes a median a standard deviation."""
    assert noise_floor(repeated(6, 1e-2), None) == pytest.approx(1.4826 * 3e-2 / np.sqrt(2.0))
    assert np.isnan(noise_floor(repeated(5, 1e-2), None))
    assert noise_floor(repeated(5, 1e-2), 1e-3) == pytest.approx(3**0.5 * 1e-3)
    norm = Observations(np.ones((3, 1, 3)), np.ones((3, 1, 3)), KnownNorm(3, G), Context(3),
                        np.arange(3), ("",) * 3)  # fmt: skip
    assert noise_floor(norm, 1e-3) == pytest.approx(1e-3)
    assert np.isnan(noise_floor(norm, None))


def split(name: str, corrected: list[float]) -> SimpleNamespace:
    """A held-out part of a level tool that reads some errors along and across, mg."""
    meant = G * np.array([[[0.0, 1.0, 0.0]]] * len(corrected))
    error = MG * np.array(corrected)[:, None, None] * np.array([0.0, 0.6, 0.8])
    return SimpleNamespace(name=name, final=Held(meant + error, meant, error))


def limited(**asked: float) -> tuple[object, ...]:
    ids = np.arange(2)
    reference = KnownVector(np.zeros(2), np.zeros(2), G, ids, ids)
    result = SimpleNamespace(
        splits=(split("leave one out", [9.0, 9.0]), split("held out", [3.0, -4.0])),
        observations=SimpleNamespace(reference=reference),
        settings=SimpleNamespace(conventions=Conventions()),
    )
    names = {k.replace("_", "-"): v for k, v in asked.items()}
    return advice.limits_of(result, names)  # type: ignore[arg-type, return-value]


def test_limits_hold_what_took_no_part_in_the_choice() -> None:
    """The last split: the strictest that there is."""
    every = limited(max_error=1.0, max_inclination_error=1.0, max_toolface_error=1.0,
                    max_norm_error=1.0)  # fmt: skip
    error, inclination, tool_face, norm = (one.value for one in every)  # type: ignore[attr-defined]
    assert error == pytest.approx(np.sqrt(12.5))
    assert inclination == pytest.approx(4e-3 * 0.8 / DEG, rel=0.01)
    assert tool_face == 0.0
    assert norm == pytest.approx(0.6 * np.sqrt(12.5), rel=0.01)
    assert every[0].name == "max-error, held out"  # type: ignore[attr-defined]
    assert limited() == ()


def test_limits_need_something_held_out() -> None:
    nothing = SimpleNamespace(splits=())
    assert advice.limits_of(nothing, {}) == ()  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="held-out"):
        advice.limits_of(nothing, {"max-error": 1.0})  # type: ignore[arg-type]
