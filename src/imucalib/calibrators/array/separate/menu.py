"""Motions that a hand, a turntable or a drill gives, from which one is advised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from imucalib.arrays import Array
from imucalib.units import DEG, STANDARD_GRAVITY

#: s, the piece of a motion that is repeated; its samples that stand for all, in stretches.
SECONDS, SAMPLES, _RUN = 5.0, 96, 8
_RATES = (300.0, 1000.0)
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
#: m/s², of a board that is shaken by hand.
_SHAKEN = 15.0


@dataclass(frozen=True)
class Motion:
    """rate, spin : (T, 3) rad/s and rad/s²; force : (T, 3) m/s², of the first IMU; board axes"""

    rate: Array
    spin: Array
    force: Array


@dataclass(frozen=True)
class MenuMotion:
    """words : about which axis, how, how fast; at : t (T,) s -> the motion"""

    words: tuple[str, str, str]
    at: Callable[[Array], Motion]


def menu(fastest: float) -> tuple[MenuMotion, ...]:
    """Every motion whose rate stays below `fastest` (rad/s)."""
    found = list[MenuMotion]()
    for peak in (r * DEG for r in _RATES if 1.2 * r * DEG < fastest):
        fast = f"{peak / DEG:.0f} deg/s"
        for name, axis in _AXES.items():
            one = np.array(axis)
            words = (name, "steadily, the axis level", fast)
            found.append(MenuMotion(words, partial(_steady, one, peak)))
            for hertz in (1.0, 3.0):
                words = (name, f"to and fro, {hertz:g} times a second", f"{fast} at most")
                found.append(MenuMotion(words, partial(_swung, one, peak, hertz)))
        for shake, how in ((0.0, ""), (_SHAKEN, " and shaken")):
            words = ("all", "twisted by hand" + how, fast)
            found.append(MenuMotion(words, partial(_twisted, peak, shake)))
    return tuple(found)


def times(interval: float) -> Array:
    """(SAMPLES,) s, neighbours at an interval, spread over the piece."""
    starts = np.linspace(0.0, SECONDS, SAMPLES // _RUN, endpoint=False)
    return np.asarray((starts[:, None] + interval * np.arange(_RUN)).ravel())


def _steady(axis: Array, peak: float, t: Array) -> Motion:
    """At one rate about a level axis, so that gravity goes round."""
    rate = np.broadcast_to(peak * axis, (len(t), 3)).copy()
    return Motion(rate, np.zeros_like(rate), _gravity(axis, peak * t))


def _swung(axis: Array, peak: float, hertz: float, t: Array) -> Motion:
    turn = 2.0 * np.pi * hertz
    rate = peak * np.cos(turn * t)[:, None] * axis
    spin = -peak * turn * np.sin(turn * t)[:, None] * axis
    return Motion(rate, spin, _gravity(axis, peak / turn * np.sin(turn * t)))


def _gravity(axis: Array, angle: Array) -> Array:
    """(T, 3) gravity square to an axis that the board has turned about by an angle (T,)."""
    first = np.roll(axis, 1)
    second = np.cross(axis, first)
    turned = np.cos(angle)[:, None] * first - np.sin(angle)[:, None] * second
    return np.asarray(STANDARD_GRAVITY * turned)


def _twisted(peak: float, shake: float, t: Array) -> Motion:
    """By hand about all axes at once, with or without pushing it about."""
    rng = np.random.default_rng(17)
    tone, phase = rng.uniform(0.5, 4.0, (6, 3)), rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    size = peak / 6.0**0.5
    angle = 2.0 * np.pi * tone * t[:, None, None] + phase
    slow = np.column_stack([np.sin(0.9 * t), np.cos(1.3 * t), np.sin(0.7 * t + 1.0)])
    force = STANDARD_GRAVITY * slow / np.linalg.norm(slow, axis=1, keepdims=True)
    return Motion(
        rate=size * np.sin(angle).sum(axis=1),
        spin=size * (2.0 * np.pi * tone * np.cos(angle)).sum(axis=1),
        force=force + shake * np.sin(1.37 * angle).sum(axis=1) / 6.0**0.5,
    )
