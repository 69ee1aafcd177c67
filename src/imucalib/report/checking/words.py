"""Verdict and causes of a check in words."""

from __future__ import annotations

import math

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.checking.check import POWER, Check, SensorCheck
from imucalib.calibration.checking.e_value import ALPHA
from imucalib.calibration.checking.misfit import FAMILIES
from imucalib.calibration.checking.statistic import ANYTHING, DRAWS
from imucalib.significant_digits import plus_minus, probability, two_digits

_FACES = ("x", "y", "z")


def verdict_words(check: Check) -> str:
    """The headline."""
    p = f"p {probability(check.p, DRAWS)}"
    if check.verdict == "changed":
        return f"Changed ({p}): {'; '.join(causes_in_words(check))}."
    short = [
        f"{_limit(name, limit)} of {name}"
        for name, limit in check.limits.items()
        if max(s.seen[name] for s in check.sensors) > limit
    ]
    if check.disturbed:
        words = [
            f"{f'{s.name}: ' if s.name else ''}{s.misfits.label[s.alone]}"
            for s in check.disturbed if s.alone is not None
        ]  # fmt: skip
        return (
            f"Undecided ({p}): only {' and '.join(words)} does not belong to the others; without "
            "it nothing shows. Hold that attitude again."
        )
    if check.verdict == "undecided":
        return (
            f"Undecided ({p}): nothing shows, but these readings could not have shown a change of "
            f"{' or '.join(short)}; they could see {_seen_words(check)}."
        )
    return (
        f"Still good ({p}): a change of {_seen_words(check)} would have been found in "
        f"{100 * POWER:.0f} % of such checks."
    )


def evidence_words(check: Check) -> str:
    """What all checks together say, in words."""
    looks = "this check" if check.looks == 1 else f"{check.looks} checks together"
    bar = 1.0 / ALPHA
    said = "enough" if check.e >= bar else "not enough"
    return (
        f"Evidence of a change by {looks}: e = {check.e:.3g}, {said}: {bar:.0f} is reached by "
        f"chance in at most {100 * ALPHA:.0f} % of calibrations, however often one looks."
    )


def _limit(name: str, value: float) -> str:
    return f"{value:.2g} {FAMILIES[name]}"


def _seen_words(check: Check) -> str:
    found = []
    for name in check.limits:
        size = max(s.seen[name] for s in check.sensors)
        shown = "no" if math.isinf(size) else f"{two_digits(size)} {FAMILIES[name]} of"
        found.append(f"{shown} {name}")
    return " or ".join(found)


def causes_in_words(check: Check) -> list[str]:
    """What changed, sensor by sensor."""
    said = [f"{f'{s.name}: ' if s.name else ''}{_causes(s)}" for s in check.changed]
    for sensor in check.drifted:
        assert sensor.gyro is not None
        axis = int(np.argmax(np.abs(sensor.gyro.bias)))
        size = plus_minus(float(sensor.gyro.bias[axis]), float(sensor.gyro.sd[axis]), "deg/s")
        said.append(f"{sensor.name}: the gyroscope's bias {_FACES[axis]} moved by {size}")
    return said


def _causes(sensor: SensorCheck) -> str:
    if not sensor.causes:
        kinds = [name for name in sensor.tests if name != ANYTHING]
        text = f"neither {' nor '.join(kinds)} alone explains it, "
        if sensor.together is None:
            return text + "and these are too few readings to tell more"
        return text + ("all together do" if sensor.together else "nor do all together")
    first = f"the {sensor.causes[0]} has changed{size_words(sensor, sensor.causes[0])}"
    if len(sensor.causes) == 1:
        return first
    others = [f"the {name}{size_words(sensor, name)}" for name in sensor.causes[1:]]
    return f"{first}, or {', or '.join(others)}: these readings cannot tell them apart"


def size_words(sensor: SensorCheck, name: str) -> str:
    """Each axis with its sd, in brackets; nothing where it is open."""
    test = sensor.tests[name]
    if np.isnan(test.size).any():
        return ""
    each = (
        f"{axis} {plus_minus(float(v), float(s))}"
        for axis, v, s in zip(_FACES, test.size, test.sd, strict=True)
    )
    return f" ({', '.join(each)} {FAMILIES[name]})"


def attitude_words(direction: Array) -> str:
    """An attitude of the hand: "+z up", "edge +x -y up"."""
    axes = [f"{'+' if v > 0 else '-'}{_FACES[k]}" for k, v in enumerate(direction) if abs(v) > 0.1]
    shape = {1: "", 2: "edge ", 3: "corner "}[len(axes)]
    return f"{shape}{' '.join(axes)} up"
