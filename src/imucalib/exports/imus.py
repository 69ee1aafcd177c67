"""IMUs, of an array or one alone, as other programs see them: frame, place and raw readings.

    accelerometer reading = L_a Q_a f + b_a,   gyro reading = L_g Q_g ω + Tg f + b_g

f and ω in board axes, L lower triangular with a positive diagonal, Q a rotation. The IMU's frame is
that in which its accelerometer's matrix is L_a: Q_a turns the board's axes into it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import Gyroscope, gyroscope_of, read_delay
from imucalib.calibration.triads import Triad
from imucalib.core.effect import Response
from imucalib.effects import catalogue
from imucalib.effects.forms import in_words
from imucalib.errors import UnreadableInput, UsageError
from imucalib.exports.nearest import beyond_linear
from imucalib.recording.identity import NAMELESS
from imucalib.recording.yaml_text import load
from imucalib.units import DEG, MG, STANDARD_GRAVITY

#: What programs that filter ask of an IMU's noise, and its units.
NOISE_UNITS = {
    "accelerometer_noise_density": "m/s2/sqrt(Hz)",
    "accelerometer_random_walk": "m/s3/sqrt(Hz)",
    "gyroscope_noise_density": "rad/s/sqrt(Hz)",
    "gyroscope_random_walk": "rad/s2/sqrt(Hz)",
}
_MEASURE = (
    "give a recording at rest to `imucal noise RECORDING --to kalibr -o noise.yaml` and `--noise "
    "noise.yaml` to `imucal export`, or state the walks there: --random-walk ACC,GYRO (SI)"
)


@dataclass(frozen=True)
class Imu:
    """By default a perfect one in the middle of the board.

    noise : keys as in Kalibr's imu.yaml, as far as they are known
    place : (3,) m in the board's frame; frame : (3, 3) board axes to the IMU's
    accelerometer, gyro : (3, 3) L of each; gyro_turn : (3, 3) IMU's frame to the gyro's
    by_force : (3, 3) rad/s per m/s², of forces in the gyro's frame
    elements : (3, 3) m, in its rows where the axes x, y and z sense, from the place, in the IMU's
        frame
    topic : of its recording
    """

    name: str
    noise: dict[str, Any]
    place: Array = field(default_factory=partial(np.zeros, 3))
    frame: Array = field(default_factory=partial(np.eye, 3))
    accelerometer: Array = field(default_factory=partial(np.eye, 3))
    gyro: Array = field(default_factory=partial(np.eye, 3))
    gyro_turn: Array = field(default_factory=partial(np.eye, 3))
    by_force: Array = field(default_factory=partial(np.zeros, (3, 3)))
    elements: Array = field(default_factory=partial(np.zeros, (3, 3)))
    topic: str = ""

    @property
    def from_board(self) -> Array:
        """(4, 4) that takes places in the board's frame into the IMU's, m."""
        moved = np.column_stack([self.frame, -self.frame @ self.place])
        return np.vstack([moved, [0.0, 0.0, 0.0, 1.0]])


def imus_of(calibration: Calibration, form: str) -> tuple[Imu, ...]:
    """Every IMU of an array's calibration, or the one with a gyroscope.

    Raises UsageError for another calibration and for left-handed sensors, which no rotation turns
    into the form's frame; UnreadableInput where positions are missing.
    """
    if (gyro := gyroscope_of(calibration)) is not None:
        return (_alone(calibration, gyro, form),)
    if not calibration.triads:
        raise UsageError(
            f"{form} holds IMUs, this calibration is of one accelerometer",
            remedy="use c-header, ggir-csv or matlab",
        )
    places = places_of(calibration)
    return tuple(_imu(calibration, t, places[k], form) for k, t in enumerate(calibration.triads))


def places_of(calibration: Calibration) -> Array:
    """(K, 3) m in the frame of the board's drawing, or of the first IMU where that is not known."""
    facts = calibration.facts
    try:
        rows = {str(row["imu"]): row["mean"] for row in facts["positions_mm"]}
        places = np.array([rows[t.name] for t in calibration.triads], dtype=float).reshape(-1, 3)
        first = np.array(facts.get("reference_mm", np.zeros(3)), dtype=float).reshape(3)
    except (KeyError, TypeError, ValueError) as error:
        raise UnreadableInput(f"the positions do not fit the IMUs: {error!r}") from None
    return np.asarray(1e-3 * (places + first))


def _imu(calibration: Calibration, triad: Triad, place: Array, form: str) -> Imu:
    back = triad.rotation.T
    lower, frame = _lower(back @ triad.gain, triad.name, form)
    gyro_lower, gyro_frame = _lower(back @ triad.gyro_gain, triad.name, form)
    # Effects act in package axes; how a sensor is wired in its package is a part of its gain.
    wired, gyro_wired = (np.round(back @ g @ triad.rotation) for g in (triad.gain, triad.gyro_gain))
    own = _effect(calibration, "gyro_g_sensitivity", triad.name, 9).reshape(3, 3)
    sensitivity = gyro_wired @ own * DEG / STANDARD_GRAVITY
    elements = _effect(calibration, "sensing_elements", "", 9).reshape(3, 3)
    elements = 1e-3 * np.abs(wired) @ elements
    return Imu(
        name=triad.name,
        place=place,
        frame=frame,
        accelerometer=lower,
        gyro=gyro_lower,
        gyro_turn=gyro_frame @ frame.T,
        by_force=sensitivity @ back @ gyro_frame.T,
        elements=elements @ (frame @ triad.rotation).T,
        noise=_noise(calibration, triad),
    )


def _alone(calibration: Calibration, gyro: Gyroscope, form: str) -> Imu:
    """One IMU, whose frame is the board's and its accelerometer's."""
    linear = calibration.matrices()
    lower, frame = _lower(linear.S, "the accelerometer", form)
    gyro_lower, turn = _lower(
        np.asarray(np.linalg.inv(gyro.gain), np.float64), "the gyroscope", form
    )
    known = calibration.facts.get("noise_density", {})
    return Imu(
        name=name_of(calibration),
        frame=frame,
        accelerometer=lower,
        gyro=gyro_lower,
        gyro_turn=turn @ frame.T,
        by_force=gyro.by_force @ turn.T,
        noise=dict(next(iter(known.values()), {})),
        topic=(calibration.sensor or NAMELESS).topic,
    )


def name_of(calibration: Calibration) -> str:
    """What the one sensor of a calibration is called."""
    return (calibration.sensor or NAMELESS).name or "imu0"


def _lower(matrix: Array, name: str, form: str) -> tuple[Array, Array]:
    """L and Q of a (3, 3) matrix."""
    if np.linalg.det(matrix) <= 0.0:
        raise UsageError(
            f"the axes that {name} reads are left-handed, {form} has rotations only",
            remedy="record with the sensor's sign or order of axes changed, or use matlab",
        )
    turn, upper = np.linalg.qr(matrix.T)
    sign = np.sign(np.diag(upper))
    return np.asarray(upper.T * sign), np.asarray((turn * sign).T)


def _effect(calibration: Calibration, name: str, imu: str, size: int) -> Array:
    """Parameters of a found effect: of one IMU, or of all where `imu` is empty."""
    for block in calibration.facts.get("effects", ()):
        if block["effect"] == name:
            values = [float(p["value"]) for p in block["parameters"]]
            names = [t.name for t in calibration.triads]
            at = names.index(imu) * size if imu else 0
            return np.array(values[at : at + size])
    return np.zeros(size)


def common_delay(calibration: Calibration) -> float:
    """s by which all gyros are late against the accelerometers: what a low-pass of either does is,
    to the first order, a delay by its time constant."""
    if (told := read_delay(calibration)) is not None:
        return told[0]
    found = _common_delays().items()
    return sum(sign * 1e-3 * float(_effect(calibration, name, "", 1)[0]) for name, sign in found)


def lost_rates(
    calibration: Calibration, kept: tuple[str, ...] = (), *, delay: bool = False
) -> tuple[str, ...]:
    """Of gyroscopes what a form has no place for, in words: the effects of one that are not kept,
    and the delay of all, unless the form holds a delay."""
    gyro = gyroscope_of(calibration)
    laws = gyro.laws if gyro else ()
    lost = tuple(in_words(e.name) for e, _, _ in laws if e.name not in kept)
    if not delay and (late := common_delay(calibration)):
        lost += (
            f"the delay of gyroscope behind accelerometer, {1e3 * late:.3f} ms: subtract it from "
            "the gyroscope's stamps",
        )
    return lost


def _common_delays() -> dict[str, float]:
    """Effects by which all gyros are late, and the sign: accelerometers that are late leave gyros
    early."""
    return {
        name: 1.0 if effect.channel == "angular_rate" else -1.0
        for name, effect in catalogue().items()
        if isinstance(effect, Response)
        and effect.lagged
        and effect.shared
        and "sample_age" not in effect.needs
    }


def _noise(calibration: Calibration, triad: Triad) -> dict[str, Any]:
    """What was stated of it (`--noise`), else the density of its noise at rest, as white."""
    known = dict(calibration.facts.get("noise_density", {}).get(triad.name, {}))
    interval = calibration.facts.get("sample_interval_s")
    if interval is None:
        return known
    root = float(np.sqrt(interval))
    return {
        "accelerometer_noise_density": triad.noise * root,
        "gyroscope_noise_density": triad.gyro_noise * root,
        "update_rate": 1.0 / float(interval),
    } | known


def lost_of(
    calibration: Calibration, kept: tuple[str, ...], *, delay: bool = False
) -> tuple[tuple[str, ...], float, float]:
    """Effects that the form has no place for, in words; and the largest rms in the motion that was
    calibrated of one of them: on a force, mg, and on a rate, deg/s.

    kept : effects that it has a place for; delay : whether it has one for a common delay
    """
    aside, largest = _common_delays(), {"m/s²": 0.0, "deg/s": 0.0}
    lost = lost_rates(calibration, (*kept, *aside), delay=delay)
    if not calibration.triads and (own := beyond_linear(calibration)):
        lost += (own,)
    for row in calibration.facts.get("not_undone", ()):
        effect, unit, rms = row["effect"], row["unit"], float(row["rms"])
        if effect not in (*kept, *aside):
            words = f"{in_words(effect)}, {rms:.3g} {unit} rms in the motion that was calibrated"
            lost += (words,)
        # A delay is known against the other sensor only: it is a rate's loss.
        held = effect in kept or (effect in aside and (delay or unit == "m/s²"))
        if not held and unit in largest:
            largest[unit] = max(largest[unit], rms)
    return lost, largest["m/s²"] / MG, largest["deg/s"]


def noise_of(imu: Imu, program: str, remedy: str = _MEASURE) -> tuple[dict[str, Any], list[str]]:
    """The keys that a program asks for, and a comment of each that only an upper limit is known of,
    which then stands in its place. Raises UsageError where one is not known at all."""
    if missing := [key for key in (*NOISE_UNITS, "update_rate") if key not in imu.noise]:
        raise UsageError(
            f"{program} needs {', '.join(missing)} of {imu.name}, of which nothing is known",
            remedy=remedy,
        )
    rate = float(f"{imu.noise['update_rate']:.9g}")
    found = {"rostopic": imu.topic or f"/{imu.name}/imu", "update_rate": rate}
    found |= {key: float(imu.noise[key]) for key in NOISE_UNITS}
    said = [
        f"# {key}: an upper limit (95 %), {NOISE_UNITS[key]}; the rests show no more."
        for key in imu.noise.get("upper_limits", ())
    ]
    return found, said


def state_walks(calibration: Calibration, accelerometer: float, gyroscope: float) -> Calibration:
    """A calibration whose random walks are stated, m/s³/√Hz and rad/s²/√Hz."""
    names = [t.name for t in calibration.triads] or [name_of(calibration)]
    known = calibration.facts.get("noise_density", {})
    walks = {"accelerometer_random_walk": accelerometer, "gyroscope_random_walk": gyroscope}
    stated = {}
    for name in names:
        own = known.get(name, {})
        limits = [key for key in own.get("upper_limits", ()) if key not in walks]
        stated[name] = {**own, **walks, "upper_limits": limits}
    return replace(calibration, facts={**calibration.facts, "noise_density": stated})


def state_noise(calibration: Calibration, path: Path) -> Calibration:
    """The calibration with what a file tells of its sensors' noise.

    Raises UnreadableInput for a file that is none, or that names none of the calibration's IMUs.
    """
    known = _read_noise(path)
    names = [t.name for t in calibration.triads] or [name_of(calibration)]
    if "" in known:  # of one sensor: so of all
        known = dict.fromkeys(names, known[""])
    if not set(known) & set(names):
        raise UnreadableInput(
            f"it has the noise of {', '.join(known)}, the calibration is of {', '.join(names)}",
            where=str(path),
        )
    return replace(calibration, facts={**calibration.facts, "noise_density": known})


def _read_noise(path: Path) -> dict[str, dict[str, Any]]:
    """Blocks by triad; one that stands alone is under "". Raises UnreadableInput for another
    file."""
    content = load(path)
    if isinstance(content, dict) and content:
        if "update_rate" in content:
            return {"": dict(content)}
        if all(isinstance(v, dict) and "update_rate" in v for v in content.values()):
            return {str(k): dict(v) for k, v in content.items()}
    raise UnreadableInput(
        "no noise of sensors",
        where=str(path),
        remedy="write it with `imucal noise RECORDING --to kalibr -o noise.yaml`",
    )
