"""What a reading scatters by when a calibration is used, as its file states it, and how well that
is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.errors import UnreadableInput
from imucalib.units import DEG, MG

#: Kinds of change, and the unit of their sizes.
FAMILIES: dict[str, str] = {"bias": "mg", "scale": "mg/g", "mounting": "deg"}
#: What a calibration of several sessions calls the errors that they share.
_CHANGES = {"session bias": "bias", "session mounting": "mounting"}
#: Degrees of freedom of a standard deviation that is taken at its word.
KNOWN = 1e6
#: Degrees of freedom that a setting's scatter has at least: below, its law has no mean, and one
#: component that hardly counts would hide every change.
_FEWEST = 4.0


@dataclass(frozen=True)
class Scatter:
    """One standard deviation (m/s² or rad) and the degrees of freedom behind it."""

    sd: float
    dof: float = KNOWN


@dataclass(frozen=True)
class Shared:
    """Noise of a bias that neighbouring readings share: share of a reading's variance, and the
    readings after which they forget."""

    share: float
    memory: float


@dataclass(frozen=True)
class CheckNoise:
    """reading : m/s², of one rest or position; setting : rad, by the name of the reference's
    component, of what was set; session : what one switching on brings, by the kind of change and
    in its unit; words : where each comes from; shared : of the readings' noise, or None
    """

    reading: Scatter
    setting: Mapping[str, Scatter]
    session: Mapping[str, Scatter]
    words: tuple[str, ...] = ()
    shared: Shared | None = None


def check_noise(
    calibration: Calibration,
    *,
    reading: float | None = None,
    session: Mapping[str, float] | None = None,
) -> CheckNoise:
    """The noise of a later recording.

    reading : m/s², instead of what the file states; session : by the kind of change and in its
    unit (bias mg, mounting deg), its scatter between power-ups instead of what the file states
    Raises UnreadableInput where neither tells the noise of a reading.
    """
    block = calibration.facts.get("noise") or {}
    words, shared = [], None
    if reading is not None:
        own = Scatter(reading)
        words.append(f"a reading scatters by {reading / MG:.3g} mg, as given")
    else:
        stated = _of_rests(calibration) or _stated(block, "reading", "mg", MG)
        if stated is None:
            raise UnreadableInput(
                "the calibration does not state the noise of a reading",
                remedy="give it: --noise 0.5mg, or calibrate again with this version",
            )
        own, shared = _with_shared(stated, block)
        words.append(
            f"a reading scatters by {own.sd / MG:.3g} mg, as in the calibration "
            + (f"({own.dof:.0f} degrees of freedom)" if own.dof < KNOWN else "(taken at its word)")
            + (f", of which neighbours share {100.0 * shared.share:.0f} %" if shared else "")
        )
    between, said = _session(calibration, session or {})
    names = ("inclination setting", "tool-face setting", "tilt")
    found = {name: _stated(block, _key(name), "deg", DEG) for name in names}
    setting = {name: _at_most(scatter) for name, scatter in found.items() if scatter is not None}
    return CheckNoise(own, setting, between, (*words, *said), shared)


def _with_shared(own: Scatter, block: Mapping[str, Any]) -> tuple[Scatter, Shared | None]:
    """A reading's noise with what its neighbours share, which can be all of it; degrees of freedom
    by Satterthwaite."""
    shared = _stated(block, "shared", "mg", MG)
    if shared is None or not shared.sd > 0.0:
        return own, None
    parts = np.array([own.sd**2, shared.sd**2])
    whole = float(parts.sum())
    dof = whole**2 / float(np.sum(parts**2 / np.array([own.dof, shared.dof])))
    memory = float(block["shared_memory_positions"])
    return Scatter(whole**0.5, dof), Shared(float(parts[1]) / whole, memory)


def _at_most(stated: Scatter) -> Scatter:
    """A setting's scatter with its own sd added: few settings may show none where there is some."""
    return Scatter(stated.sd * (1.0 + 0.5 / stated.dof) ** 0.5, max(stated.dof, _FEWEST))


def _of_rests(calibration: Calibration) -> Scatter | None:
    """Of an array's rests: n rests of K triads leave 3 K n - 2 n - 12 K degrees of freedom."""
    rests = calibration.facts.get("rests")
    if not calibration.triads or not isinstance(rests, Mapping):
        return None
    n, k = int(rests["count"]), len(calibration.triads)
    return Scatter(float(rests["residual_m_per_s2"]), max(3.0 * k * n - 2 * n - 12 * k, 1.0))


def _session(
    calibration: Calibration, given: Mapping[str, float]
) -> tuple[dict[str, Scatter], tuple[str, ...]]:
    """What a power-up brings: as given, as the file states it, or nothing."""
    if given:
        said = ", ".join(f"{size:.3g} {FAMILIES[name]} of {name}" for name, size in given.items())
        words = f"power-ups scatter by {said}, as given"
        return {name: Scatter(size) for name, size in given.items()}, (words,)
    found = stated_sessions(calibration)
    if found:
        said = ", ".join(f"{s.sd:.3g} {FAMILIES[name]} of {name}" for name, s in found.items())
        return found, (f"power-ups scatter by {said}, as in the calibration",)
    return {}, (
        "the scatter of biases between power-ups is not in it: the file states none "
        "(--between-sessions)",
    )


def stated_sessions(calibration: Calibration) -> dict[str, Scatter]:
    """What a power-up brings by the kind of change, of a calibration of several; empty of one."""
    stated = calibration.facts.get("between_sessions")
    if not isinstance(stated, Mapping):
        return {}
    # One size for three axes, from so many sessions.
    dof = 3.0 * (len(stated["sessions"]) - 1)
    return {
        _CHANGES[row["what"]]: Scatter(float(row["sd"]), dof)
        for row in stated["scatter"] if row["what"] in _CHANGES
    }  # fmt: skip


def _key(name: str) -> str:
    return name.replace(" ", "_").replace("-", "_")


def _stated(block: Mapping[str, Any], name: str, unit: str, si: float) -> Scatter | None:
    """A standard deviation of the noise block; its own sd tells its degrees of freedom,
    var(s) = s² / 2ν."""
    value = block.get(f"{name}_{unit}")
    if value is None:
        return None
    sd, spread = float(value) * si, float(block.get(f"{name}_sd_{unit}") or 0.0) * si
    return Scatter(sd, max(0.5 * (sd / spread) ** 2, 1.0) if spread > 0.0 and sd > 0.0 else KNOWN)
