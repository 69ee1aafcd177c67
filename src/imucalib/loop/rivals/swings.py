"""Swings, and what their phase or their size may be told by: then either may be the cause."""

from __future__ import annotations

from string import ascii_lowercase

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.effects import known

#: Harmonics of the tool-face that tell the phase of a swing, and the share of its power from which
#: on they do.
_SWING, _HARMONICS, _IN_STEP = ("cycle@", "scale_cycle@"), 6, 0.8
#: Share of a tool-face's turning that goes at one pace, from which on it has one, and turns over a
#: recording by which what changes the size of what it causes, as the inclination, moves that pace.
_PACED, _MOVED = 0.5, 0.5
#: Turns by which two swings must part over a recording to be two.
_APART = 1.5


def beats(context: Context, one: str, other: str) -> bool:
    """Whether two swings are nearer in frequency than the recording is long: together they are one
    whose size changes."""
    if not (one.startswith(_SWING) and other.startswith(_SWING)):
        return False
    swings = known(one), known(other)
    if swings[0] is None or swings[1] is None or swings[0].needs != swings[1].needs:
        return False
    first, second = (number(name.partition("@")[2]) for name in (one, other))
    span = float(np.ptp(context[swings[0].needs[0]]))
    return abs(1.0 / first - 1.0 / second) * span < _APART


def number(value: str) -> float:
    """The number of a value such as "7.3rows", "222s" or "0.5h"."""
    return float(value.rstrip(ascii_lowercase))


def swings_in_step(before: Fit, name: str) -> bool:
    """Whether a swing, or one that it stands beside, keeps step with what else may cause it."""
    if not name.startswith(_SWING):
        return False
    swings = [name, *(n for n in before.model.names if n.startswith(_SWING))]
    effects = [effect for n in swings if (effect := known(n)) is not None]
    return any(keeps_step(before.observations.context, effect) for effect in effects)


def keeps_step(context: Context, swing: Effect) -> bool:
    """Whether the phase of a swing is told by the tool-face, or by the temperature and its change:
    then either may be its cause. So, of a scale, may a tool-face that turns at nearly its
    pace: what goes with that and changes its size, as with the inclination, beats."""
    angle = 2.0 * np.pi * context[swing.needs[0]] / number(swing.name.partition("@")[2])
    wave = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    t = context["tool_face"]
    turns = min(_HARMONICS, max(1, len(np.unique(np.round(np.mod(t, 2.0 * np.pi), 6))) // 2))
    scale = swing.name.startswith(_SWING[1])
    if scale and any(_beats_with(angle, k * t) for k in range(1, turns + 1)):
        return True
    columns = [f(k * t) for k in range(1, turns + 1) for f in (np.cos, np.sin)]
    if "temperature" in context and np.ptp(context["temperature"]) > 0.0:
        warm = context["temperature"] - context["temperature"].mean()
        return max(_told(wave, columns), _told(wave, [warm, warm**2, np.gradient(warm)])) > _IN_STEP
    return _told(wave, columns) > _IN_STEP


def _beats_with(angle: Array, turned: Array) -> bool:
    """Whether a swing's angle (n,) and that of a tool-face part by less than `_MOVED` turns over
    the recording, either way round."""
    share = (angle - angle[0]) / (angle[-1] - angle[0])
    apart = np.linspace(-_MOVED, _MOVED, 41)[:, None] * 2.0 * np.pi * share
    power = [np.abs(np.exp(1j * (turned + way * angle + apart)).mean(axis=1)) for way in (-1, 1)]
    return bool(np.max(power) ** 2 > _PACED)


def _told(wave: Array, columns: list[Array]) -> float:
    """Share of a wave's power that columns and a constant explain, adjusted for their number."""
    design = np.linalg.qr(np.column_stack([np.ones(len(wave)), *columns]))[0]
    centred = wave - wave.mean(axis=0)
    rest = centred - design @ (design.T @ centred)
    left = max(len(wave) - design.shape[1], 1) / (len(wave) - 1)
    return float(1.0 - np.sum(rest**2) / np.sum(centred**2) / left)
