"""Calibrations of consecutive parts of a recording, kept with the one of the whole."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.calibration.calibration import (
    Calibration,
    stored_covariance,
    stored_parameters,
)
from imucalib.calibration.file import parameter_from
from imucalib.core.fit import Fit
from imucalib.errors import UnreadableInput, UsageError

#: The block of calibration.yaml that holds the parts.
BLOCK = "series"


#: s on the calibration's clock from which on each one is valid, in order of time.
Parts = tuple[tuple[float, Calibration], ...]


def series_facts(
    whole: Calibration, parts: Iterable[tuple[float, float, Fit | None]], *, differ: bool
) -> dict[str, Any]:
    """The block of parts (start s, stop s, fit or None); apply uses them where they differ.

    What a part's fit does not have, such as an effect that the search found, it has from `whole`.
    """
    rows = []
    names = [p.name for p in whole.parameters]
    for start, stop, fit in parts:
        row: dict[str, Any] = {"start_s": start, "stop_s": stop}
        if fit is not None:
            own = {p.name: p for p in stored_parameters(fit)}
            at = np.array([names.index(name) for name in own])
            covariance = whole.covariance.copy()
            covariance[at], covariance[:, at] = 0.0, 0.0
            covariance[np.ix_(at, at)] = stored_covariance(fit)
            row["parameters"] = [vars(own.get(p.name, p)) for p in whole.parameters]
            row["covariance"] = covariance.tolist()
        rows.append(row)
    return {BLOCK: {"use": "parts" if differ else "whole", "parts": rows}}


def parts_of(calibration: Calibration, use: str | None = None) -> Parts:
    """The parts to apply; none where the calibration of the whole is to be used.

    use : "parts" or "whole"; by default what the calibration says. A part that could not be
    calibrated has the calibration of the whole. Raises UsageError when "parts" are wanted and
    there are none, UnreadableInput when the block is damaged.
    """
    block = calibration.facts.get(BLOCK)
    if block is None:
        if use == "parts":
            raise UsageError(
                "the calibration has no parts", remedy="calibrate with --every, for example 7d"
            )
        return ()
    try:
        if (use or block["use"]) != "parts":
            return ()
        calibration.facts["clock"]["span_s"]  # a part is valid at times of this clock
        return tuple(_part(calibration, row) for row in block["parts"])
    except (KeyError, TypeError, ValueError) as error:
        raise UnreadableInput(f"the parts of the calibration are damaged: {error!r}") from None


def _part(whole: Calibration, row: dict[str, Any]) -> tuple[float, Calibration]:
    if "parameters" not in row:
        return float(row["start_s"]), whole
    parameters = tuple(map(parameter_from, row["parameters"]))
    covariance = np.array(row["covariance"], dtype=float).reshape(2 * (len(parameters),))
    own = replace(whole, parameters=parameters, covariance=covariance)
    return float(row["start_s"]), own


def part_at(parts: Parts, time: Array) -> NDArray[np.intp]:
    """Number of the part that is valid at each time (s); beyond the ends, of the nearest."""
    starts = np.array([start for start, _ in parts])
    return np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)
