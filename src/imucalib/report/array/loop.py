"""The array's closed loop in the report, the YAML and the JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.curves import CURVE
from imucalib.calibrators.array.loop.held_out import NORMAL_MAD
from imucalib.calibrators.array.loop.terms import Term
from imucalib.calibrators.array.loop.worth import size_in_words
from imucalib.estimators.array.noise import SensorNoise
from imucalib.loop.found import Step
from imucalib.report.document import Block, Facts, Section, Table, Text
from imucalib.report.loop import candidate_rows
from imucalib.significant_digits import probability
from imucalib.units import DEG


def array_loop_section(loop: MotionLoop | None) -> Section:
    """What was found, step by step, what it did to held-out residuals, and what stays."""
    if loop is None:
        return Section("Closed loop", (Text("The search was not run."),))
    blocks: list[Block] = [_verdict(loop)]
    if loop.asked.declare:
        facts = tuple((t.name, size_in_words(loop.final, t)) for t in declared_terms(loop))
        blocks.append(Table("Declared effects", ("effect", "size"), facts, "ll"))
    limits = [
        f"{words} {', '.join(names)}"
        for words, names in (("only", loop.asked.only), ("without", loop.asked.without)) if names
    ]  # fmt: skip
    if limits:
        blocks.append(Text(f"The search was limited: {'; '.join(limits)}."))
    if loop.steps:
        rows = tuple(
            (
                s.effect,
                s.value,
                probability(s.p, s.draws),
                f"{s.evidence:.1f}",
                ", ".join(f"{gain:.0f}" for gain in s.gains),
                *_checked(s),
                ", ".join(s.aliases) or "-",
            )
            for s in loop.steps
        )
        header = ("effect added", "size", "p", "nats", "held out, nats", "acc, m/s²",
                  "gyro, deg/s", "cannot be told from")  # fmt: skip
        note = (
            "p is the chance in the whole search. Held out: what each half of the motion gains by "
            "the effect as the other half has it. Residuals: median absolute deviation, held out."
        )
        blocks.append(Table("Steps of the loop", header, rows, "llrrrrrl", note))
    blocks.append(_residuals(loop))
    blocks.append(_noise(loop))
    return Section("Closed loop", tuple(blocks))


def _checked(step: Step) -> tuple[str, str]:
    """Accelerometers and gyros before and after; a step at rest has the rests' error alone."""
    said = {c.name: f"{c.before:.3g} -> {c.after:.3g}" for c in step.checked}
    return said.get("accelerometers", said.get("rests", "-")), said.get("gyros", "-")


def declared_terms(loop: MotionLoop) -> tuple[Term, ...]:
    """Effects that the user put into the model, as finally fitted."""
    return tuple(term for term in loop.final.found if term.name in loop.asked.declare)


def _verdict(loop: MotionLoop) -> Text:
    if not loop.asked.search:
        return Text("Fitted with the declared effects; the search was not run.")
    causes = [step for step in loop.steps if not step.curve]
    names = ", ".join(" or ".join((s.effect, *s.aliases)).replace("_", " ") for s in causes)
    left = ", ".join(f"{u.name} ({u.driver})" if u.driver else u.name for u in loop.unexplained)
    if len(causes) < len(loop.steps):
        left += "; corrected by a curve: "
        left += ", ".join(s.effect.removeprefix(CURVE) for s in loop.steps if s.curve)
    return {
        "nothing missing": Text("Nothing is missing: no candidate passes the search.", "ok"),
        "explained": Text(f"The residual is explained by {names}.", "ok"),
        "explained in part": Text(
            f"The residual is explained in part by {names}; left: {left}.", "warning"
        ),
        "unexplained": Text(
            f"Unexplained structure: {left}. No effect of the catalogue fits.", "bad"
        ),
    }[loop.verdict]


def _residuals(loop: MotionLoop) -> Table:
    rows = tuple(
        (name, f"{before:.3f}", f"{after:.3f}", f"{NORMAL_MAD * before:.3f}",
         f"{NORMAL_MAD * after:.3f}")
        for name, before, after in (
            ("accelerometers, m/s²", loop.before.acceleration, loop.after.acceleration),
            ("gyros, deg/s", loop.before.rate, loop.after.rate),
        )
    )  # fmt: skip
    header = ("", "MAD before", "after", "1.4826 MAD before", "after")
    note = (
        "Held out: each half of the motion, in blocks, under positions and effects of the other; "
        "ω, dω/dt and s are every sample's own."
    )
    return Table("Residuals before and after", header, rows, "lrrrr", note)


def _noise(loop: MotionLoop) -> Facts:
    a, g = loop.final.noise
    return Facts(
        (
            ("accelerometer noise", noise_words(a, 1.0, "m/s²")),
            ("gyro noise", noise_words(g, DEG, "deg/s")),
            ("shared by neighbours", f"{loop.dispersion:.2f} times fewer samples"),
        )
    )


def noise_words(noise: SensorNoise, unit: float, name: str) -> str:
    """The distribution in words."""
    words = f"{noise.sigma / unit:.3g} {name}"
    if noise.growth > 0.0:
        words += f" times sqrt(1 + (|ω| / {1.0 / noise.growth / DEG:.0f} deg/s)²)"
    if np.isfinite(noise.freedom):
        words += f", Student t of {noise.freedom:g} degrees of freedom"
    if noise.gained > 0.0:
        words += f"; held-out halves gain {noise.gained:.0f} nats by that shape"
    return words


def array_candidate_section(loop: MotionLoop) -> Section:
    """Every candidate of the last search, why not, and what no motion can show."""
    header = ("candidate", "kind", "evidence (nats)", "p", "left (%)", "λ at typical size")
    note = (
        "Last search, after everything above was added. Left: share of the effect that positions "
        "and accepted effects do not absorb. λ of about 4.7 gives an 80 % chance to find the "
        "effect at its typical size."
    )
    rows = tuple(r for r in candidate_rows(loop.scores) if "@" not in r[0] or r[2] > "1")
    blocks: list[Block] = [Table("All candidates", header, rows, "llrrrr", note)]
    why = "; ".join(f"{name}: {reason}" for name, reason in (*loop.rejected, *loop.missing.items()))
    if why:
        blocks.append(Text(f"Rejected or not tested: {why}."))
    if loop.impact:
        table = tuple((a["effect"], a["typical"], a["positions"]) for a in absorbed_list(loop))
        words = ("not testable", "at", "moves the positions by, mm rms")
        blocks.append(
            Table("What this motion cannot show", words, table, "llr",
                  "Absorbed by the positions, the motion or effects already in the model.")
        )  # fmt: skip
    return Section("Candidates tried", tuple(blocks), brief=False)


def absorbed_list(loop: MotionLoop) -> list[dict[str, Any]]:
    """Effects that cannot be seen, with what their typical size would do to the positions."""
    found = []
    for name, impact in loop.impact.items():
        parameter = array_catalogue()[name].each[0]
        found.append(
            {
                "effect": name,
                "typical": f"{parameter.typical:g} {parameter.unit}",
                "positions": f"{1e3 * impact:.2g}" if impact > 1e-9 else "0",
                "positions_mm_rms": 1e3 * impact,
            }
        )
    return found


def loop_dict(loop: MotionLoop) -> dict[str, Any]:
    """The loop in report.json."""
    return {
        "verdict": loop.verdict if loop.asked.search else "not searched",
        "declared": [
            {"effect": t.name, "size": size_in_words(loop.final, t)} for t in declared_terms(loop)
        ],
        "only": list(loop.asked.only),
        "without": list(loop.asked.without),
        "steps": [
            {"effect": s.effect, "size": s.value, "p_value": s.p, "draws": s.draws,
             "evidence_nats": s.evidence, "held_out_nats": list(s.gains),
             "checked": [vars(c) for c in s.checked],
             "aliases": list(s.aliases)}
            for s in loop.steps
        ],
        "residual_mad_before": residual_dict(loop.before),
        "residual_mad_after": residual_dict(loop.after),
        "rejected": [{"effect": n, "reason": r} for n, r in loop.rejected],
        "unexplained": [
            {"name": u.name, "driver": u.driver, "kind": u.kind, "p_value": u.p,
             "evidence_nats": u.evidence, "share_of_residual": u.share}
            for u in loop.unexplained
        ],
        "not_testable": absorbed_list(loop),
        "missing": dict(loop.missing),
        "noise": {"accelerometer": noise_dict(loop.final.noise[0]),
                  "gyroscope": noise_dict(loop.final.noise[1]),
                  "shared_by_neighbours": loop.dispersion},
        "beats_hz": [] if loop.ages is None else [
            float(f) if np.isfinite(f) else None for f in loop.ages.clock.frequency
        ],
        "candidates": [
            {"name": s.name, "kind": s.candidate.kind, "evidence_nats": s.evidence, "p_value": s.p,
             "left": s.left, "strength": s.strength, "absorbed": s.absorbed}
            for s in loop.scores
        ],
    }  # fmt: skip


def residual_dict(found: Any) -> dict[str, float]:
    return {"acceleration_m_per_s2": found.acceleration, "rate_deg_per_s": found.rate}


def noise_dict(noise: SensorNoise) -> dict[str, Any]:
    return {
        "sigma_si": noise.sigma,
        "growth_s_per_rad": noise.growth,
        "student_t": noise.freedom if np.isfinite(noise.freedom) else None,
        "factor_of_imu": noise.factor.tolist(),
        "held_out_nats": noise.gained,
    }
