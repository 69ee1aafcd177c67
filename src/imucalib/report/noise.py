"""The report of `imucal noise`, as a document and as plain types."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.data import Data
from imucalib.estimators.allan import SHAPES
from imucalib.exports.noise import NOISE_FORMS
from imucalib.inspection.noise import Coefficient, SensorNoise, noisiest
from imucalib.report.render.document import Document, Plot, Section, Series, Table, Text
from imucalib.units import DEG, MG

#: Of each term: unit, and SI in one of it.
_UNITS = {
    "acceleration": {
        "white": ("µg/√Hz", 1e-3 * MG),
        "instability": ("µg", 1e-3 * MG),
        "walk": ("µg/s/√Hz", 1e-3 * MG),
        "ramp": ("µg/h", 1e-3 * MG / 3600.0),
    },
    "angular_rate": {
        "white": ("deg/√h", DEG / 60.0),
        "instability": ("deg/h", DEG / 3600.0),
        "walk": ("deg/h/√h", DEG / 3600.0 / 60.0),
        "ramp": ("deg/h/h", DEG / 3600.0**2),
    },
}
#: Other words for white noise and walk: what it is called, unit, SI in one of it.
_ALSO = {
    "acceleration": (
        ("white", "noise density", "m/s²/√Hz", 1.0),
        ("white", "velocity random walk", "m/s/√h", 1.0 / 60.0),
        ("walk", "bias random walk", "m/s³/√Hz", 1.0),
    ),
    "angular_rate": (
        ("white", "noise density", "rad/s/√Hz", 1.0),
        ("white", "noise density", "deg/s/√Hz", DEG),
        ("walk", "bias random walk", "rad/s²/√Hz", 1.0),
    ),
}
_SENSORS = {"acceleration": "accelerometer", "angular_rate": "gyroscope"}
_SAMPLE = {"acceleration": ("mg", MG), "angular_rate": ("deg/s", DEG)}
_NOISE = (
    "White noise N, bias instability B, random walk K and ramp R of the overlapping Allan variance "
    "N²/τ + 0.441 B² + K² τ/3 + R² τ²/2, with 95 % intervals over all of them together. <: what it "
    "lies below with 95 % probability, the recording being too short, or too quiet in it, to show "
    "it."
)


def compose_noise_document(path: str, noise: Sequence[SensorNoise], typed: str) -> Document:
    """The terms of every axis, of the noisiest axes in other units, the Allan deviations with what
    explains them, and the files to make of it.

    path : the recording; noise : of at least one sensor; typed : the recording and the options of
    its reading, as a command takes them
    """
    tables, plots = list(_tables(noise)), tuple(_plots(noise))
    longest = max(sensor.axes[0].curve.longest for sensor in noise)
    words = f"{_count_sensors(noise)} at rest, up to {longest:.0f} s at a time."
    files = (
        Text(f"`imucal noise {typed} --to {form} -o {made.file}`: {made.reads}")
        for form, made in NOISE_FORMS.items()
    )
    parts = (
        Section("Noise at rest", (*tables, *_settling(noise)), kept=True),
        Section("In other units", (_in_other_units(noise),)),
        Section("Allan deviation", plots),
        Section("Next", tuple(files)),
    )
    return Document(path, Text(words), parts, drawn="--html")


def _count_sensors(noise: Sequence[SensorNoise]) -> str:
    counts = {q: sum(s.quantity == q for s in noise) for q in _SENSORS}
    return " and ".join(f"{n} {_SENSORS[q]}{'s' * (n > 1)}" for q, n in counts.items() if n)


def _tables(noise: Sequence[SensorNoise]) -> Iterator[Table]:
    """One a kind of sensor: a row an axis."""
    note = _NOISE
    for quantity, units in _UNITS.items():
        own = [sensor for sensor in noise if sensor.quantity == quantity]
        rows = tuple(
            (
                f"{sensor.triad} {letter}",
                *(_cell(getattr(axis, term), scale) for term, (_, scale) in units.items()),
            )
            for sensor in own
            for letter, axis in zip("xyz", sensor.axes, strict=False)
        )
        if own:
            header = ("axis", *(f"{term}, {unit}" for term, (unit, _) in units.items()))
            seconds = own[0].axes[0].curve.seconds
            title = f"{quantity.replace('_', ' ')}: {seconds:.0f} s at rest"
            yield Table(title, header, rows, "lrrrr", note)
            note = ""


def _cell(found: Coefficient, scale: float) -> str:
    if found.value is None or found.low is None or found.high is None:
        return f"< {float(f'{found.below / scale:.2g}'):.9g}"
    value, low, high = (f"{v / scale:.4g}" for v in (found.value, found.low, found.high))
    return f"{value} ({low} to {high})"


def _settling(sensors: Sequence[SensorNoise]) -> Iterator[Text]:
    """The rests that are not used."""
    for sensor in sensors:
        if sensor.settles:
            spans = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in sensor.settles)
            yield Text(f"{sensor.triad}: louder than the quietest rests, not used: {spans}")


def _in_other_units(noise: Sequence[SensorNoise]) -> Table:
    """The noisiest axis of every sensor."""
    rows = []
    for sensor in noise:
        name = f"{sensor.triad} {_SENSORS[sensor.quantity]}"
        most = {term: getattr(noisiest(sensor.axes, term), term) for term in ("white", "walk")}
        unit, scale = _SAMPLE[sensor.quantity]
        words = f"sd of a sample at {sensor.rate:.4g} Hz"
        rows.append((name, words, _cell(most["white"], scale / np.sqrt(sensor.rate)), unit))
        for term, words, unit, scale in _ALSO[sensor.quantity]:
            rows.append((name, words, _cell(most[term], scale), unit))
    note = "Of the noisiest axis, as files for other programs have it."
    return Table("", ("sensor", "what", "value", "unit"), tuple(rows), "llrl", note)


def _plots(noise: Sequence[SensorNoise]) -> Iterator[Plot]:
    """One a kind of sensor: the noisiest axis of each, and what explains it, where it does."""
    for quantity, (unit, scale) in _SAMPLE.items():
        series: list[Series] = []
        for sensor in noise:
            if sensor.quantity != quantity:
                continue
            worst = noisiest(sensor.axes, "white")
            curve, x = worst.curve, np.log10(worst.curve.tau)
            low, high = (edge / scale for edge in curve.interval())
            series.append(Series(sensor.triad, x, curve.deviation / scale, "points", low, high))
            middle, low, high = worst.fit[:, worst.holds] / scale
            label = f"{sensor.triad}, explained"
            series.append(Series(label, x[worst.holds], middle, "line", low, high))
        if series:
            caption = (
                "Overlapping Allan deviation of each sensor's noisiest axis with its 95 % "
                "intervals, and the sum of its terms where they explain it."
            )
            name = quantity.replace("_", " ")
            labels = (f"Allan deviation, {name}", "log10 τ, s", unit)
            yield Plot(*labels, tuple(series), caption, log_y=True)


class Allan(Data):
    """The overlapping Allan deviation of one axis, and what explains it."""

    tau_s: Array
    deviation: Array
    low: Annotated[Array, "Of its 95 % interval."]
    high: Array
    fit: Annotated[Array, "Of the sum of the terms: median, and 95 % interval."]
    holds: Annotated[Flags, "Where the terms explain it."]


class AxisAtRest(Data):
    """One axis, in SI."""

    triad: Annotated[str, "The sensor that it is of."]
    quantity: str
    unit: str
    rate_hz: float
    axis: str
    quantisation: Coefficient
    white: Coefficient
    instability: Coefficient
    walk: Coefficient
    ramp: Coefficient
    allan: Allan


class NoiseAtRest(Data, name="noise/1"):
    """The noise of every axis of the sensors of a recording."""

    path: str
    noise: tuple[AxisAtRest, ...]
    not_used_s: Annotated[
        Mapping[str, tuple[tuple[float, float], ...]],
        "Of each sensor rests that are louder than the quietest.",
    ]


def describe_noise(path: str, noise: Sequence[SensorNoise]) -> NoiseAtRest:
    """What `imucal noise` tells machines."""
    axes = (_describe_axis(sensor, k) for sensor in noise for k in range(len(sensor.axes)))
    settles = {sensor.triad: sensor.settles for sensor in noise if sensor.settles}
    return NoiseAtRest(path, tuple(axes), settles)


def _describe_axis(sensor: SensorNoise, k: int) -> AxisAtRest:
    axis, curve = sensor.axes[k], sensor.axes[k].curve
    allan = Allan(curve.tau, curve.deviation, *curve.interval(), axis.fit, axis.holds)
    terms = {term: getattr(axis, term) for term in SHAPES}
    return AxisAtRest.of(sensor, "rate_hz=rate", axis="xyz"[k], allan=allan, **terms)
