"""What a result of `lab` means and what to do next, in sentences and in limits."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from imucalib.calibration.calibration import UNSETTLED
from imucalib.calibration.findings import advice_of, find_hidden
from imucalib.calibration.outcome import Limit
from imucalib.calibration.uncertainty import select_correctable
from imucalib.calibrators.lab.bench import RawUnit, row_numbers
from imucalib.calibrators.lab.calibrate import LabResult
from imucalib.calibrators.lab.design import judge
from imucalib.calibrators.lab.errors import (
    attitude_errors,
    reading_noise,
    rms,
    setting_noise,
    worst,
)
from imucalib.calibrators.lab.faults import SCATTER
from imucalib.core.effect import Described
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.references import KnownVector, angles_of, unit_vector
from imucalib.core.sphere import KnownDirection
from imucalib.effects import known
from imucalib.effects.forms import in_words
from imucalib.errors import UsageError
from imucalib.estimators.corrected import OBJECTIVES
from imucalib.posterior.closed_loop.found import Unexplained
from imucalib.posterior.record_errors import RecordError
from imucalib.posterior.search.trust import split_at_jump
from imucalib.question import Question, paste
from imucalib.units import DEG, MG

#: Share of a place from which on an effect is worth telling apart.
_WORTH_TELLING = 0.05
#: Standard deviation of a log whose 95 % interval is a factor of two either way.
_FACTOR_TWO = np.log(2.0) / 1.96


def settle(what: str, record: RecordError, raw: RawUnit) -> Question:
    """A record error with the options that settle it: the repair where it is known."""
    row = record.where.split()[-1]
    words = [("--fix", f"{row}:{axis}={value / raw.si:.10g}") for axis, value in record.fix]
    repair = tuple(word for pair in words for word in pair)
    out = ("--exclude", row)
    other = f"{paste(*out)}, or --auto-exclude" if repair else "--auto-exclude"
    return Question(what, repair or out, other)


def find_undecided(result: LabResult) -> tuple[Question, ...]:
    """Jumps of the bench after which the readings do not say which part stands as it was set."""
    found = list[Question]()
    if result.loop is None:
        return ()
    base = result.loop.base
    rows = row_numbers(base.observations)
    for step in result.loop.steps:
        effect = known(step.effect)
        parts = None if effect is None else split_at_jump(base, base.model, effect)
        if parts is not None:
            first, then = (f"{r.min()}-{r.max()}" for r in (rows[~parts.after], rows[parts.after]))
            what = (
                f"rows {first} stand as they were set, rows {then} do not: the readings fit the "
                "other way round as well"
            )
            found.append(Question(what, ("--trust", first), f"--trust {then}"))
    return tuple(found)


def reasons(result: LabResult) -> tuple[str, ...]:
    """Why the status is not "ok": short, machine-stable beginnings."""
    found: list[str] = []
    loop = result.loop
    if not result.final.converged:
        found.append(UNSETTLED)
    if loop and loop.records:
        found.append(f"record errors: {', '.join(r.where for r in loop.records)}")
    if loop and loop.unexplained:
        found.append(f"unexplained structure: {in_words(loop.unexplained[0].name)}")
    if result.request.objective in OBJECTIVES and result.final.null_directions:
        found.append(
            f"objective '{result.request.objective}' leaves open on these rows: "
            + "; ".join(result.final.null_directions)
        )
    if result.request.sigma is not None and chance_of_factor(result.final) < 0.01:
        found.append(f"noise not as declared: {result.final.noise.factor:.2f} times --sigma")
    return tuple(found)


def advice(result: LabResult, raw: RawUnit) -> tuple[str | Question, ...]:
    """Sentences: what was found, what it means, which recording would settle what is open."""
    loop, fit = result.loop, result.final
    found: list[str | Question] = [*_repeat(fit)]
    for record in loop.records if loop else ():
        found.append(settle(f"{record.where}: the calibration takes it as it stands", record, raw))
    for step in loop.steps if loop else ():
        effect = known(step.effect)
        others = [
            one.effect
            for one in step.in_its_place
            if one.effect != step.effect and one.share > _WORTH_TELLING
        ]
        names = " or ".join(map(in_words, (step.effect, *others)))
        if others and effect is not None:
            found.append(f"These positions cannot tell {names} apart. {effect.identify}")
        elif effect is not None and effect.stage == "fixture":
            sentence = _by_row(effect.sentence, fit)
            found.append(f"{sentence} Check the bench ({effect.identify.rstrip('.')}).")
        elif isinstance(effect, Described) and effect.remedy:
            found.append(f"{effect.sentence} To settle it: {effect.remedy}.")
    found += [_of_structure(item) for item in (loop.unexplained if loop else ())]
    if isinstance(fit.observations.reference, KnownVector):
        found += _settings(fit)
    found += _positions(result)
    if loop:
        found += advice_of(find_hidden(loop.scores, loop.final.model.names))
    return tuple(found)


def _repeat(fit: Fit) -> list[str]:
    """What tells noise and setting errors apart, where they are known to a factor of two only."""
    if fit.mixture is None or fit.mixture.log_sd.max() < _FACTOR_TWO:
        return []
    faces = isinstance(fit.observations.reference, KnownDirection)
    what = "face" if faces else "position"
    return [
        f"Take every {what} twice, set anew each time: {fit.observations.n} rows hardly tell the "
        "sensor's noise from how it was set, and all intervals are as wide as that."
    ]


def _of_structure(item: Unexplained) -> str:
    by = f", driven by {item.driver}" if item.driver else ""
    words = f"Structure without a name{by}: {in_words(item.name)}"
    rivals = [effect for name in item.rivals if (effect := known(name)) is not None]
    if rivals:
        how = "To tell them apart" if item.kind == "noise" else "To settle it"
        return f"{words}. {how}: {' '.join(effect.identify for effect in rivals)}"
    if item.driver:
        return f"{words}. Record with {item.driver} varied on its own."
    return f"{words}; no quantity drives it."


def _by_row(sentence: str, fit: Fit) -> str:
    """A sentence that counts records, with the name that the table has for its own."""
    counted = re.search(r"record (\d+)", sentence)
    if counted is None or "record" not in fit.observations.context:
        return sentence
    at = np.flatnonzero(fit.observations.context["record"] == int(counted[1]) - 1)
    if not at.size:
        return sentence
    return sentence.replace(counted[0], fit.observations.label[int(at[0])])


def _settings(fit: Fit) -> list[str]:
    """Whose the scatter is: the table's settings or the sensor's noise."""
    noise = setting_noise(fit)
    sensor = reading_noise(fit).whole
    reference = fit.observations.reference
    assert isinstance(reference, KnownVector)
    share = sensor / reference.gravity / DEG
    floor = noise.get("tool-face setting", 0.0) / DEG
    if 2.0 * share < floor <= SCATTER:
        return [
            f"Tool-face scatters by {floor:.2f} deg because the table is set by hand, not because "
            f"of the sensor ({share:.2f} deg / cos(inclination)): no calibration on this table can "
            f"show less, and a smaller residual would be overfitting."
        ]
    return []


def _positions(result: LabResult) -> list[str]:
    """The one position that would help most, when it helps much.

    Judged by the norm, which no setting error touches: what it leaves weak, the bench's angles
    can only mend as well as they are set.
    """
    fit = result.final
    core = Model(
        tuple(
            e for e in select_correctable(fit.model).effects if not e.needs and e.stage == "sensor"
        )
    )
    reference = fit.observations.reference
    if isinstance(reference, KnownVector):
        angles = (reference.inclination, reference.tool_face)
    else:
        angles = angles_of(reference.truth(fit.eta)[:, 0])
    first = judge(core, *angles, norm=True).additions[0]
    if first.gain < 1.5:
        return []
    gain = f"{first.gain:.1f} times" if np.isfinite(first.gain) else "decisively"
    inside = np.array([first.inclination * DEG]), np.array([first.tool_face * DEG])
    if isinstance(reference, KnownVector):
        shown = result.request.conventions.outside(*inside)
        where = f"inclination {shown[0][0]:.0f}, tool-face {shown[1][0]:.0f}"
    else:  # whoever has no dials cannot set them
        x, y, z = unit_vector(*inside)[0]
        word = "direction" if isinstance(reference, KnownDirection) else "gravity along"
        where = f"{word} {x:.2f}, {y:.2f}, {z:.2f}"
    return [f"One more position at {where} would determine {_word(first.parameter)} {gain} better."]


def _word(parameter: str) -> str:
    """A parameter's name for a reader: "scale_z" is the scale of z."""
    what, _, axis = parameter.rpartition("_")
    if len(axis) == 1:
        return f"the {what.replace('_', ' ')} of {axis}"
    return parameter.replace("_", " ")


def limits_of(result: LabResult, limits: Mapping[str, float]) -> tuple[Limit, ...]:
    """The user's limits against held-out errors. Raises UsageError for what was not held out."""
    if not limits:
        return ()
    if not result.splits:
        raise UsageError("limits need held-out data", remedy="use another objective, or --train")
    split = result.splits[-1]
    angles = attitude_errors(split.final, result.request.conventions)
    values = {
        "max-error": (split.final.rms() / MG, "mg rms"),
        "max-norm-error": (rms(angles.norm), "mg rms"),
    }
    if isinstance(result.observations.reference, KnownVector):
        values["max-inclination-error"] = (worst(angles.inclination), "deg")
        values["max-toolface-error"] = (worst(angles.tool_face), "deg")
    for name in limits:
        if name not in values:
            raise UsageError(f"--{name} needs known angles", remedy="use --max-error")
    return tuple(
        Limit(f"{name}, {split.name}", values[name][0], limit, values[name][1])
        for name, limit in limits.items()
    )


def chance_of_factor(fit: Fit) -> float:
    """Chance of a noise factor this far above 1 if the declared noise were true.

    Chi-square (upper tail), with as many degrees of freedom as the estimate of the factor is worth:
    settings that scatter take some away.
    """
    from scipy.special import chdtrc

    spread = float(fit.noise_covariance[0, 0])
    dof = 0.5 / spread if spread > 0.0 else float(fit.dof)
    return float(chdtrc(dof, dof * fit.noise.factor**2))
