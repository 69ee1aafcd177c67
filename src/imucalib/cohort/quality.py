"""What a study's manager asks of one recording: which device, how much of it, how good."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

#: How readers begin the note that names a device.
_DEVICE = re.compile(r"(?:ActiGraph|GENEActiv|Axivity AX\d) (?!of unknown)([\w-]+)")


def device_of(report: Mapping[str, Any]) -> str | None:
    """Serial number of the device, where the recording's file names it."""
    return next((m[1] for n in report["notes"] if (m := _DEVICE.match(n))), None)


def quality_of(report: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of one recording from its report.json; None where a report does not tell.

    Hours in h, errors and standard deviations in the report's unit (mg for one sensor),
    temperatures in °C.
    """
    coverage, activity = report.get("coverage", {}), report.get("activity") or {}
    held = report["loop"]["errors"][0]["held_out"]
    warm = coverage.get("temperature_degC") or (None, None)
    span = coverage.get("axis_range_g")
    worst, size = _worst(report.get("sphere", ()))
    enmo = activity.get("enmo_mg", {}).get("all") or {}
    return {
        "serial": device_of(report),
        "rate_hz": coverage.get("rate_hz"),
        "hours_recorded": _rounded(activity.get("hours_recorded", coverage.get("hours"))),
        "hours_worn": _rounded(activity.get("hours_worn")),
        "gaps": report["provenance"]["gaps"],
        "still_windows": coverage.get("still_windows"),
        "posture_runs": coverage.get("posture_runs"),
        "axes_seen_both_ways": _both_ways(span) if span else None,
        "norm_sd_largest_mg": _rounded(coverage.get("norm_sd_largest_mg")),
        "temperature_least_degC": warm[0],
        "temperature_largest_degC": warm[1],
        "error_before": _rounded(held["raw"]),
        "error_after": _rounded(held["final"]),
        "worst_direction": worst,
        "worst_direction_error_mg": _rounded(size),
        "enmo_before_mg": _rounded(enmo.get("raw")),
        "enmo_after_mg": _rounded(enmo.get("corrected")),
    }


def _worst(cells: Any) -> tuple[str | None, float | None]:
    """The direction with the largest held-out error of those that were seen."""
    seen = [c for c in cells if c["held_out_mg"] is not None]
    if not seen:
        return None, None
    worst = max(seen, key=lambda c: float(c["held_out_mg"]))
    return worst["name"], worst["held_out_mg"]


def _both_ways(span: Mapping[str, Any]) -> str:
    """Axes that gravity has pulled by 0.5 g both ways: "xyz", or those that it has not left out."""
    return "".join(a for a, (low, high) in span.items() if low < -0.5 and high > 0.5) or "none"


def _rounded(value: Any) -> float | None:
    return None if value is None else float(f"{value:.5g}")
