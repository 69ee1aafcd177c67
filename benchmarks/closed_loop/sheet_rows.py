"""The rows of the table of independent bench sheets, each with its mark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from table import Row, quantiles, share
from trial import Trial

#: Names from the catalogue that are the same curve as a form.
ALIASES = {
    "bias:order:exponential": ("warm_up",),
}
#: Names from the catalogue that are true of what was planted.
TRUE_OF = {"late_reading": {"hysteresis"}, "thermal_lag": {"thermal_lag"}, "slip": {"slip"}}
#: What a calibration on the run's own rows can correct.
CORRECTABLE = ("third_harmonic", "local_sine", "random_walk", "shock", "slip", "pick_up",
               "soft_saturation")  # fmt: skip


def _of(trials: Sequence[Trial], scenario: str) -> list[Trial]:
    return [t for t in trials if t.job.scenario == scenario]


def _ratio(trials: Sequence[Trial], below: str) -> list[float]:
    return [t.after / getattr(t, below) for t in trials if not t.refused]


def rows(trials: Sequence[Trial]) -> list[Row]:
    """Every row of the table."""
    return [
        *_clean(_of(trials, "clean")),
        *_taken(_of(trials, "taken")),
        *_one(_of(trials, "one"), _of(trials, "strong"), _of(trials, "two")),
        *_outside(_of(trials, "outside")),
        *_forms(_of(trials, "form"), _of(trials, "clean")),
        *_junk(_of(trials, "junk")),
        *_rest(trials),
    ]


def _clean(some: list[Trial]) -> list[Row]:
    n = len(some)
    return [
        ("clean: a cause from the catalogue claimed", n, share(some, _cause), "<= 2 %"),
        ("clean: anything added, curves too", n, share(some, lambda t: bool(t.sets)), "-"),
        ("clean: refused as a slip, or a record doubted", n,
         share(some, lambda t: bool(t.refused or t.records)), "-"),
        ("clean: 'explained' while held out is not better", n,
         share(some, lambda t: t.verdict == "explained" and t.told >= 0.0), "0"),
    ]  # fmt: skip


def _cause(t: Trial) -> bool:
    return any(s[0] not in ("shape", "curve") for s in t.sets)


def _found(t: Trial) -> bool:
    """What was planted is in a set; of a form, the form of what it bends."""
    name = t.job.effects[0][0]
    return any(n.startswith(("shape@response", "curve@response")) for n in t.names) if (
        ":" in name) else t.within  # fmt: skip


def _taken(some: list[Trial]) -> list[Row]:
    out: list[Row] = []
    for name in dict.fromkeys(t.job.effects[0][0] for t in some):
        own = [t for t in some if t.job.effects[0][0] == name]
        words = "converter-like curve" if ":" in name else name
        out.append((f"{words}, AR noise, λ >= 10: taken", len(own), share(own, _found), ">= 97 %"))
        over = quantiles(_ratio(own, "oracle"), 0.5, 0.9)
        out.append((f"{words}: error / oracle, median and 90 %", len(own), over, "<= 1.05, 1.2"))
    return out


def _one(one: list[Trial], strong: list[Trial], two: list[Trial]) -> list[Row]:
    return [
        ("one effect, 6 <= λ < 10: reported", len(one), share(one, lambda t: t.within), ">= 97 %"),
        ("one effect, 6 <= λ < 10: told, beside noise or as refused too", len(one),
         share(one, lambda t: t.within or t.job.effects[0][0] in t.alike), "-"),
        ("one effect, λ >= 10: first", len(strong), share(strong, lambda t: t.first), ">= 97 %"),
        ("one effect, λ >= 10: error / oracle, median and 90 %", len(strong),
         quantiles(_ratio(strong, "oracle"), 0.5, 0.9), "<= 1.05, 1.2"),
        ("one effect: wrong name as certain", len(one + strong),
         share(one + strong, lambda t: t.wrong), "-"),
        ("one effect, λ >= 10: the word is 'explained'", len(strong),
         share(strong, _explained), "-"),
        ("two effects, λ 12 each: both reported", len(two), share(two, lambda t: t.within),
         ">= 92 %"),
        ("two effects: the word is 'explained'", len(two), share(two, _explained), "-"),
    ]  # fmt: skip


def _explained(t: Trial) -> bool:
    return t.verdict == "explained" and t.told < 0.0


def _wrong(t: Trial) -> bool:
    assert t.job.outside is not None
    formless = set(t.certain) - {"shape", "curve"}
    return bool(formless - TRUE_OF.get(t.job.outside[0], set()))


def _outside(some: list[Trial]) -> list[Row]:
    mend = [t for t in some if t.job.outside and t.job.outside[0] in CORRECTABLE]
    out: list[Row] = [
        ("outside: a wrong cause as certain", len(some), share(some, _wrong), "0"),
        ("outside: truth after / before, largest", len(some),
         quantiles(_ratio(some, "before"), 1.0), "<= 1.05"),
        ("outside: worse than 1.05", len(some),
         share(some, lambda t: bool(t.before) and t.after > 1.05 * t.before), "0"),
        ("outside, correctable: after / before, median", len(mend),
         quantiles(_ratio(mend, "before"), 0.5), "<= 0.6"),
    ]  # fmt: skip
    for name in dict.fromkeys(t.job.outside[0] for t in some if t.job.outside):
        own = [t for t in some if t.job.outside and t.job.outside[0] == name]
        over = quantiles(_ratio(own, "before"), 0.5, 1.0)
        silent = share(own, lambda t: not t.alarm)
        out.append((f"{name}: after / before, median and largest", len(own), over, "-"))
        out.append((f"{name}: nothing said", len(own), silent, "-"))
    return out


def _right(t: Trial) -> bool:
    assert t.job.outside is not None
    what, driver, kind, *_ = t.job.outside[0].split(":")
    for name in t.names:
        said = name.partition("@")[2].split(":")
        if name.startswith("shape@") and said[0] == what and said[2] == kind:
            return True
        if name.partition("@")[0] in ALIASES.get(f"{what}:{driver}:{kind}", ()):
            return True
    return False


def _forms(some: list[Trial], clean: list[Trial]) -> list[Row]:
    out: list[Row] = [
        ("forms: right family, or an alias", len(some), share(some, _right), ">= 80 %"),
        ("forms: a form or curve on clean sheets", len(clean),
         share(clean, lambda t: any(n.startswith(("shape@", "curve@")) for n in t.names)),
         "<= 2 %"),
        ("forms: after / before, median", len(some), quantiles(_ratio(some, "before"), 0.5), "-"),
    ]  # fmt: skip
    for name in dict.fromkeys(t.job.outside[0] for t in some if t.job.outside):
        own = [t for t in some if t.job.outside and t.job.outside[0] == name]
        out.append((f"`{name}`: right", len(own), share(own, _right), "-"))
    return out


def _junk(some: list[Trial]) -> list[Row]:
    if not some:
        return []
    told, new = np.array([t.told for t in some]), np.array([t.new for t in some])
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(some), (2000, len(some)))
    low, high = np.quantile(told[draws].mean(1) / new[draws].mean(1), (0.025, 0.975))
    said = f"{told.mean() / new.mean():.2f} ({low:.2f} to {high:.2f})"
    return [("junk: change held out / on new sheets, mg²", len(some), said, "0.8-1.25")]


def _rest(trials: Sequence[Trial]) -> list[Row]:
    usual = [
        t for t in trials if t.intervals and not t.job.outside and t.job.noise == "gaussian"
    ]  # fmt: skip
    hits, count = sum(t.covered for t in usual), sum(t.intervals for t in usual)
    cover = f"{100.0 * hits / count:.1f} % ({hits}/{count})" if count else "-"
    runs = [t.seconds for t in trials if not t.job.junk]
    return [
        ("95 % intervals of the final parameters cover", len(usual), cover, "93-97 %"),
        ("CPU s a run, median and 90 %", len(runs), quantiles(runs, 0.5, 0.9), "-"),
    ]
