"""What a reading scatters by when a calibration is used, as its file states it, how well that is
known, and the sizes that a user states with their unit: "2mg", "0.1deg", "0.5deg/s", "0.2mm"."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.errors import UsageError
from imucalib.units import DEG, MG

#: Kinds of change, and the unit of their sizes.
FAMILIES: dict[str, str] = {"bias": "mg", "scale": "mg/g", "mounting": "deg"}
#: What a calibration of several sessions calls the errors that they share.
_CHANGES = {"session bias": "bias", "session mounting": "mounting"}
#: Degrees of freedom of a standard deviation that is believed as stated.
KNOWN = 1e6
#: Degrees of freedom that a setting's scatter has at least: below, its law has no mean, and one
#: component that hardly counts would hide every change.
_FEWEST = 4.0
#: What matters, by its unit: mg of a force or bias, deg of a direction, deg/s of a rate, mm of a
#: position.
Limits = Mapping[str, float]
UNITS = ("mg", "deg", "deg/s", "mm")


@dataclass(frozen=True)
class Scatter:
    """One standard deviation (m/s² or rad) and its degrees of freedom."""

    sd: float
    dof: float = KNOWN


@dataclass(frozen=True)
class CheckNoise:
    """reading : m/s², of one rest or position; setting : rad, by the name of the reference's
    component, of what was set; session : what one switching on brings, by the kind of change and
    in its unit; words : where each comes from
    share : of a reading's variance that a bias shared with its neighbours has; memory : readings
    after which they forget
    """

    reading: Scatter
    setting: Mapping[str, Scatter]
    session: Mapping[str, Scatter]
    words: tuple[str, ...] = ()
    share: float = 0.0
    memory: float = math.inf


def check_noise(
    calibration: Calibration,
    *,
    reading: float | None = None,
    session: Mapping[str, float] | None = None,
) -> CheckNoise:
    """The noise of a later recording.

    reading : m/s², instead of what the file states; session : by the kind of change and in its
    unit (bias mg, mounting deg), its scatter between power-ups instead of what the file states
    Raises UsageError where neither tells the noise of a reading.
    """
    block = calibration.facts.get("noise") or {}
    share, memory = 0.0, math.inf
    if reading is not None:
        own, said = Scatter(reading), "given"
    else:
        own, share, memory = _reading(calibration, block)
        known = f"{own.dof:.0f} degrees of freedom" if own.dof < KNOWN else "taken at its word"
        said = f"in the calibration ({known})"
        said += f", of which neighbours share {100.0 * share:.0f} %" if share else ""
    between = {name: Scatter(size) for name, size in (session or {}).items()}
    source = "as given" if between else "as in the calibration"
    between = between or read_sessions(calibration)
    words = (
        f"power-ups scatter by {sizes_in_words(between)}, {source}"
        if between
        else "the scatter of biases between power-ups is not in it: the file states none "
        "(--between-sessions)"
    )
    setting = {}
    for name in ("inclination setting", "tool-face setting", "tilt"):
        found = _read_sd(block, name.replace(" ", "_").replace("-", "_"), "deg", DEG)
        if found is not None:
            # With its own sd added: few settings may show none where there is some.
            sd = found.sd * (1.0 + 0.5 / found.dof) ** 0.5
            setting[name] = Scatter(sd, max(found.dof, _FEWEST))
    return CheckNoise(
        own,
        setting,
        between,
        (f"a reading scatters by {own.sd / MG:.3g} mg, as {said}", words),
        share,
        memory,
    )


def sizes_in_words(scatter: Mapping[str, Scatter]) -> str:
    """Scatter by the kind of change, each with its unit."""
    return ", ".join(f"{s.sd:.3g} {FAMILIES[name]} of {name}" for name, s in scatter.items())


def _reading(calibration: Calibration, block: Mapping[str, Any]) -> tuple[Scatter, float, float]:
    """A reading's noise with what its neighbours share, which can be all of it; the share and the
    memory of `CheckNoise`. Degrees of freedom by Satterthwaite."""
    own, shared = _of_rests(calibration), _read_sd(block, "shared", "mg", MG)
    own = own or _read_sd(block, "reading", "mg", MG)
    if own is None:
        raise UsageError(
            "the calibration does not state the noise of a reading",
            remedy="calibrate again with this version; `imucal check` takes it as --noise 0.5mg",
        )
    if shared is None or not shared.sd > 0.0:
        return own, 0.0, math.inf
    parts = np.array([own.sd**2, shared.sd**2])
    whole = float(parts.sum())
    dof = whole**2 / float(np.sum(parts**2 / np.array([own.dof, shared.dof])))
    memory = float(block["shared_memory_positions"])
    return Scatter(whole**0.5, dof), float(parts[1]) / whole, memory


def _of_rests(calibration: Calibration) -> Scatter | None:
    """Of an array's rests: n rests of K triads leave 3 K n - 2 n - 12 K degrees of freedom."""
    rests = calibration.facts.get("rests")
    if not calibration.triads or not isinstance(rests, Mapping):
        return None
    n, k = int(rests["count"]), len(calibration.triads)
    return Scatter(float(rests["residual_m_per_s2"]), max(3.0 * k * n - 2 * n - 12 * k, 1.0))


def read_sessions(calibration: Calibration) -> dict[str, Scatter]:
    """What a power-up brings by the kind of change, of a calibration of several; empty of one."""
    stated = calibration.facts.get("between_sessions")
    if not isinstance(stated, Mapping):
        return {}
    # One size for three axes, from so many sessions.
    dof = 3.0 * (len(stated["sessions"]) - 1)
    return {
        _CHANGES[row["what"]]: Scatter(float(row["sd"]), dof)
        for row in stated["scatter"]
        if row["what"] in _CHANGES
    }


def _read_sd(block: Mapping[str, Any], name: str, unit: str, si: float) -> Scatter | None:
    """A standard deviation of the noise block; its own sd tells its degrees of freedom,
    var(s) = s² / 2ν."""
    value = block.get(f"{name}_{unit}")
    if value is None:
        return None
    sd, spread = float(value) * si, float(block.get(f"{name}_sd_{unit}") or 0.0) * si
    return Scatter(sd, max(0.5 * (sd / spread) ** 2, 1.0) if spread > 0.0 and sd > 0.0 else KNOWN)


def size_of(text: str, units: Sequence[str] = UNITS) -> tuple[float, str]:
    """Number and unit of "2mg". Raises UsageError."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(\S+)\s*", text)
    try:
        number = float(match[1]) if match else math.nan
    except ValueError:
        number = math.nan
    if match is None or match[2] not in units or not 0.0 < number < math.inf:
        raise UsageError(
            f"'{text}' is no size above zero with one of the units {', '.join(units)}",
            remedy=f"write it as one word, for example 0.5{units[0]}",
        )
    return number, match[2]


def limits_of(texts: Sequence[str]) -> Limits:
    """The limits that a user stated, each once. Raises UsageError."""
    sizes = [size_of(text) for text in texts]
    found = {unit: number for number, unit in sizes}
    if len(found) < len(sizes):
        twice = next(unit for _, unit in sizes if [u for _, u in sizes].count(unit) > 1)
        raise UsageError(f"two limits in {twice}", remedy="state each once")
    return found


def sessions_of(texts: Sequence[str]) -> dict[str, float]:
    """Scatter between power-ups by the kind of change: bias (mg), mounting (deg). Raises
    UsageError."""
    sizes = [size_of(text, ("mg", "deg")) for text in texts]
    return {"bias" if unit == "mg" else "mounting": size for size, unit in sizes}
