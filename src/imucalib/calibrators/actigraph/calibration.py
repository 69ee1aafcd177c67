"""The calibration that an actigraph run writes, and the blocks that people read beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from imucalib.calibration import sums
from imucalib.calibration.ambiguity import KEY
from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.outcome import Limit, Outcome
from imucalib.calibration.power import advice_of, hidden
from imucalib.calibration.series import series_facts
from imucalib.calibrators.actigraph.calibrate import ActigraphResult
from imucalib.calibrators.actigraph.coverage import Coverage
from imucalib.calibrators.actigraph.errors import mean_error, sphere_cells
from imucalib.calibrators.actigraph.observations import from_data, open_words
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.series import Series, series_block
from imucalib.calibrators.next_recording import recorded_block
from imucalib.core.effect import CLOCKS
from imucalib.core.fit import Fit
from imucalib.core.sphere import counted
from imucalib.effects.forms import in_words
from imucalib.loop.found import FitLoop
from imucalib.rests.runs import Scan
from imucalib.units import MG

#: The field calls a calibration good below this error (mg); a tenth of it is well known.
_GOOD, _WELL_KNOWN = 10.0, 1.0
#: What to do about what moves with time, by its kind, or where no temperature was recorded, the
#: most telling first.
_TOLD = {
    "cold": "The error moves with time and no temperature was recorded: export the temperature "
    "channel too, or calibrate in parts with --every 1d.",
    "probe": "The error moves with time, in too few stretches to prove a cause: --every 6h shows "
    "which parts differ, a longer recording whether it comes back.",
}


def reasons(result: ActigraphResult, coverage: Coverage) -> tuple[str, ...]:
    """Why the calibration is not simply good."""
    found = [coverage_words(result, coverage)] if result.weak else []
    missing, largest = coverage.unseen, coverage.worst_sd
    if largest > _WELL_KNOWN and not result.weak:
        where = f"; no posture with {', '.join(missing)}" if missing else ""
        found.append(f"the error in some directions is known to {largest:.1f} mg only{where}")
    held = mean_error(result.final_held)
    if held > _GOOD:
        found.append(f"the held-out error of {held:.1f} mg is above the field's 10 mg")
    raw = result.error.held_out.raw
    if held > raw:
        found.append(f"on held-out time it is worse than no calibration ({raw:.2f} mg)")
    if result.light > 0.02 * result.runs.n:
        found.append(
            f"{result.light} of {result.runs.n} posture runs are unlike the rest and count less"
        )
    return tuple(found)


def coverage_words(result: ActigraphResult, coverage: Coverage) -> str:
    """What weak coverage of the sphere leaves open, in the field's terms."""
    missing = coverage.unseen
    count = f"{result.runs.n} posture run" + "s" * (result.runs.n != 1)
    never = f" (never {', '.join(missing)})" if missing else ""
    text = f"weak coverage of the sphere: {count}{never} leave open {open_words(result.base)}"
    if result.beside_fleet:
        text += "; what is open stays as devices of its kind have it"
    elif result.base.prior is not None:
        text += "; what is open stays near its nominal value, with a data sheet's uncertainty"
    return f"{text}; |a| is known to {coverage.worst_sd:.1f} mg in the worst direction"


def advice(result: ActigraphResult, coverage: Coverage) -> tuple[str, ...]:
    """The next steps, most useful first."""
    found = []
    missing = coverage.unseen
    if result.beside_fleet:
        found.append("What the model lacks is not searched for beside a fleet.")
    elif result.weak and result.loop is None:
        found.append(
            "What the nine parameters lack was not searched for: that takes postures which "
            "determine all of them."
        )
    elif result.few:
        found.append(
            "What the nine parameters lack was not searched for: that takes twice as many posture "
            "runs as parameters."
        )
    if missing and coverage.worst_sd > _WELL_KNOWN:
        found.append(
            f"Rest the sensor for ten seconds with {', '.join(missing)}, or record more nights."
        )
    elif coverage.worst_sd > _WELL_KNOWN:
        found.append("More postures at rest, in new directions, make the parameters better known.")
    loop = result.loop
    if loop is not None:
        found += _open_ends(loop, warm="temperature" in result.final.observations.context)
        found += advice_of(hidden(loop.scores, loop.final.model.names))
    return tuple(found)


def _open_ends(loop: FitLoop, *, warm: bool) -> list[str]:
    """What to do about what the search left open; warm : whether a temperature was recorded."""
    kinds = {u.kind for u in loop.unexplained if u.driver in CLOCKS}
    if kinds and not warm:
        kinds.add("cold")
    kind = next((kind for kind in _TOLD if kind in kinds), "")
    found = [_TOLD[kind]] if kind else []
    if loop.steps and loop.steps[0].aliases:
        step = loop.steps[0]
        name = in_words(step.effect)
        found.append(
            f"{name[0].upper()}{name[1:]} cannot be told from "
            f"{', '.join(map(in_words, step.aliases))}: "
            "both correct this recording alike; a longer one, with more postures, separates them."
        )
    return found


def limits_of(result: ActigraphResult, asked: Mapping[str, float]) -> tuple[Limit, ...]:
    """The user's limits against what was found."""
    held = mean_error(result.final_held)
    value = {
        "max-error": held,
        "max-worst-error": float(np.abs(result.final_held.error).max()) / MG,
    }
    return tuple(Limit(name, value[name], limit, "mg") for name, limit in asked.items())


def actigraph_calibration(
    outcome: Outcome,
    result: ActigraphResult,
    scanned: Scan,
    request: ActigraphRequest,
    details: Mapping[str, Any],
    parts: Series | None,
) -> Calibration:
    """The calibration of a run's final fit."""
    facts: dict[str, Any] = {
        "gravity_source": request.gravity_source,
        "frame": "x keeps its direction; gravity alone cannot see a rotation of the frame",
        "clock": {"start_ns": scanned.start_ns, "span_s": max(scanned.stop, 1.0)},
        "errors": [error.as_dict() for error in outcome.errors],
        "error_mg": details["error_mg"],
        "noise": _noise_block(result.final),
        "coverage": details["coverage"],
        "postures": counted(result.final.observations.reading[:, 0]).tolist(),
        "from_data": details["from_data"],
        "provenance": outcome.provenance.as_dict(),
    }
    whole = from_fit(
        result.final,
        "actigraph",
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=request.gravity,
        status=outcome.status,
        reasons=outcome.reasons,
        facts=facts,
    )
    if parts is None:
        return whole
    fits = [(part.start, part.stop, part.fit) for part in parts.parts]
    return replace(whole, facts=facts | series_facts(whole, fits, differ=parts.differ))


def actigraph_details(
    result: ActigraphResult, coverage: Coverage, parts: Series | None
) -> dict[str, Any]:
    """What only a worn sensor has to say, for report.json; the shorter blocks also for the YAML."""
    details: dict[str, Any] = {
        "error_mg": _error_block(result),
        "coverage": coverage.as_dict(),
        "from_data": _data_share_block(result.final),
        "sphere": _sphere_block(result),
    }
    if parts is not None:
        details["series"] = series_block(parts)
    if result.loop is not None and result.loop.wander is not None:
        wander = result.loop.wander
        if result.loop.sums is not None:
            details[sums.KEY] = sums.sums_block(result.loop.sums)
        details[KEY] = recorded_block(
            result.final,
            result.loop.ambiguous,
            reading=MG * wander.scatter,
            settings={},
            drift=wander.sd,
        )
    return details


def _error_block(result: ActigraphResult) -> dict[str, Any]:
    """Mean error of |a| over posture runs, mg: raw, nine parameters, final; rms beside."""
    error = result.error
    return {
        "metric": "mean absolute error of the norm over posture runs",
        "raw": error.raw,
        "base_fitted": error.base,
        "final_fitted": error.final,
        "base_held_out": error.held_out.base,
        "final_held_out": error.held_out.final,
        "base_held_out_rms": result.base_held.rms() / MG,
        "final_held_out_rms": result.final_held.rms() / MG,
        "held_out_blocks": int(np.unique(result.final.observations.group).size),
    }


def _noise_block(fit: Fit) -> dict[str, float]:
    """What one posture scatters by when it comes again, mg, with its sd."""
    sigma = fit.noise.factor * float(np.median(fit.at.sigma)) / MG
    return {"reading_mg": sigma, "reading_sd_mg": sigma * float(fit.noise_sd[0])}


def _data_share_block(fit: Fit) -> dict[str, float]:
    """Of each parameter: 1 - (sd / typical size)², 0 where nothing was learnt, 1 where all was."""
    return {p.name: float(v) for p, v in zip(fit.parameters, from_data(fit), strict=True)}


def _sphere_block(result: ActigraphResult) -> list[dict[str, Any]]:
    """Error over the sphere, cell by cell."""
    cells = sphere_cells(result.base, result.final, result.final_held)
    return [
        {
            ("name" if k == "name" else k if k == "runs" else f"{k}_mg"): v
            for k, v in asdict(c).items()
        }
        for c in cells
    ]
