"""What a reading scatters by when a calibration is used, as its file states it, and how well that
is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from imucalib.calibration.calibration import Calibration
from imucalib.errors import UnreadableInput
from imucalib.units import DEG, MG

#: Degrees of freedom of a standard deviation that is taken at its word.
KNOWN = 1e6


@dataclass(frozen=True)
class Scatter:
    """One standard deviation (m/s² or rad) and the degrees of freedom behind it."""

    sd: float
    dof: float = KNOWN


@dataclass(frozen=True)
class CheckNoise:
    """reading : of one rest or position; setting : by the name of the reference's component, of
    what was set; session : a bias of each axis that one switching on brings, none if sd is 0
    words : where each comes from
    """

    reading: Scatter
    setting: Mapping[str, Scatter]
    session: Scatter
    words: tuple[str, ...] = ()


def check_noise(
    calibration: Calibration, *, reading: float | None = None, session: float | None = None
) -> CheckNoise:
    """The noise of a later recording.

    reading : m/s², instead of what the file states; session : m/s², scatter of the biases between
    power-ups, where the file states none
    Raises UnreadableInput where neither tells the noise of a reading.
    """
    block = calibration.facts.get("noise") or {}
    words = []
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
        own = stated
        words.append(
            f"a reading scatters by {own.sd / MG:.3g} mg, as in the calibration "
            f"({own.dof:.0f} degrees of freedom)"
        )
    between, said = _session(calibration, block, session)
    names = ("inclination setting", "tool-face setting", "tilt")
    found = {name: _stated(block, _key(name), "deg", DEG) for name in names}
    setting = {name: scatter for name, scatter in found.items() if scatter is not None}
    return CheckNoise(own, setting, between, (*words, said))


def _of_rests(calibration: Calibration) -> Scatter | None:
    """Of an array's rests: n rests of K triads leave 3 K n - 2 n - 12 K degrees of freedom."""
    rests = calibration.facts.get("rests")
    if not calibration.triads or not isinstance(rests, Mapping):
        return None
    n, k = int(rests["count"]), len(calibration.triads)
    return Scatter(float(rests["residual_m_per_s2"]), max(3.0 * k * n - 2 * n - 12 * k, 1.0))


def _session(
    calibration: Calibration, block: Mapping[str, Any], given: float | None
) -> tuple[Scatter, str]:
    """The bias of a power-up: as given, as the file states it, or none."""
    if given is not None:
        return Scatter(given), f"biases scatter by {given / MG:.3g} mg between power-ups, as given"
    sessions = calibration.facts.get("between_sessions") or {}
    stated = sessions.get("bias_mg") if isinstance(sessions, Mapping) else None
    if isinstance(stated, int | float):
        sd, spread = float(stated) * MG, float(sessions.get("bias_sd_mg") or 0.0) * MG
        dof = 0.5 * (sd / spread) ** 2 if spread > 0.0 else KNOWN
        return Scatter(sd, dof), f"biases scatter by {sd / MG:.3g} mg between power-ups, as stated"
    shared = _stated(block, "shared", "mg", MG)
    if shared is not None and shared.sd > 0.0:
        return shared, f"neighbouring readings share {shared.sd / MG:.3g} mg, as in the calibration"
    return Scatter(0.0), (
        "the scatter of biases between power-ups is not in it: the file states none "
        "(--between-sessions)"
    )


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
