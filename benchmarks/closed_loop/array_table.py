"""The table of the array's trials: what was measured in each scenario, beside its mark."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import array_world
import numpy as np
from trial import Trial

Trials = Sequence[Trial]
Test = Callable[[Trial], bool]
#: What was measured, of how many trials, the measure, and its mark.
Row = tuple[str, int, str, str]


def share(trials: Trials, test: Test) -> str:
    """ "96.5 % (193/200)" """
    hits = sum(test(t) for t in trials)
    return f"{100.0 * hits / len(trials):.1f} % ({hits}/{len(trials)})" if trials else "-"


def quantiles(values: Iterable[float], *levels: float) -> str:
    """Quantiles as text."""
    found = [v for v in values if np.isfinite(v)]
    if not found:
        return "-"
    return ", ".join(f"{q:.2f}" for q in np.quantile(found, levels))


def _of(trials: Trials, scenario: str) -> list[Trial]:
    return [t for t in trials if t.job.scenario == scenario or t.job.scenario.startswith(scenario)]


def _ratio(trials: Trials, below: str) -> list[float]:
    return [t.after / max(getattr(t, below), 1e-12) for t in trials]


def table(trials: Trials) -> str:
    """One Markdown table."""
    rows = [
        *_clean(trials),
        *_noise(trials),
        *_one(trials),
        *_two(trials),
        *_outside(trials),
        *_confounded(trials),
        *_absorbed(trials),
        *_rest(trials),
    ]
    lines = ["| array | trials | measured | mark |", "|---|---|---|---|"]
    lines += [f"| {a} | {b} | {c} | {d} |" for a, b, c, d in rows]
    return "\n".join(lines) + "\n"


def _clean(trials: Trials) -> list[Row]:
    clean = _of(trials, "clean")
    if not clean:
        return []
    return [
        ("clean: any alarm", len(clean), share(clean, lambda t: t.alarm), "<= 6 %"),
        (
            "clean: an effect named as certain",
            len(clean),
            share(clean, lambda t: t.named),
            "<= 2 %",
        ),
        ("clean: an effect added", len(clean), share(clean, lambda t: bool(t.sets)), "-"),
    ]


def _noise(trials: Trials) -> list[Row]:
    rows: list[Row] = []
    for scenario in dict.fromkeys(t.job.scenario for t in trials):
        if not scenario.startswith("noise: "):
            continue
        some, kind = _of(trials, scenario), scenario.removeprefix("noise: ")
        loud = [t for t in some if t.alarm]
        rows.append((f"clean, {kind}: named", len(some), share(some, lambda t: t.named), "<= 5 %"))
        rows.append((f"clean, {kind}: alarm", len(some), share(some, lambda t: t.alarm), "-"))
        said = share(loud, lambda t: not t.sets)
        rows.append((f"clean, {kind}: alarms that speak of noise", len(loud), said, ">= 80 %"))
    return rows


def _one(trials: Trials) -> list[Row]:
    one = [t for t in _of(trials, "one effect") if t.strength]
    rows: list[Row] = []
    middle = [t for t in one if 6.0 <= t.strength[0] < 10.0]
    high = [t for t in one if t.strength[0] >= 10.0]
    low = [t for t in one if 3.0 <= t.strength[0] < 6.0]
    sizes = [len(s) for t in middle for s in t.sets if t.job.effects[0][0] in s]
    within, first = share(middle, lambda t: t.within), share(middle, lambda t: t.first)
    rows.append(("6 <= λ < 10: in the set", len(middle), within, ">= 97 %"))
    rows.append(("6 <= λ < 10: first", len(middle), first, ">= 88 %"))
    mean = f"{np.mean(sizes):.2f}" if sizes else "-"
    rows.append(("6 <= λ < 10: set size, mean", len(sizes), mean, "<= 2"))
    rows.append(("λ >= 10: first", len(high), share(high, lambda t: t.first), ">= 97 %"))
    over = quantiles(_ratio(high, "oracle"), 0.5, 0.9)
    rows.append(("λ >= 10: error / oracle, median and 90 %", len(high), over, "<= 1.03, 1.10"))
    wrong = share(low, lambda t: t.wrong)
    rows.append(("3 <= λ < 6: wrong name as certain", len(low), wrong, "<= 1 %"))
    over = quantiles(_ratio(low, "oracle"), 0.9)
    rows.append(("3 <= λ < 6: error / oracle, 90 %", len(low), over, "<= 1.8"))
    return rows


def _two(trials: Trials) -> list[Row]:
    two = _of(trials, "two effects")
    # Effects too weak to be found by anyone do not count against the sets.
    seen = [t for t in two if t.strength and min(t.strength) >= 4.7]
    over = quantiles(_ratio(two, "oracle"), 0.5, 0.75)
    return [
        ("two effects: both in sets", len(two), share(two, lambda t: t.within), ">= 92 %"),
        ("where both λ >= 4.7: both in sets", len(seen), share(seen, lambda t: t.within), "-"),
        ("two effects: error / oracle, median and 75 %", len(two), over, "<= 1.05, 1.3"),
    ]


def _outside(trials: Trials) -> list[Row]:
    rows: list[Row] = []
    drivers = array_world.OUTSIDE
    for words, named, ratio in (("strong", "<= 5 %", "<= 0.6"), ("weak", "<= 15 %", "<= 1.05")):
        some = _of(trials, f"outside, {words}")
        rows.append((f"outside, {words}: named", len(some), share(some, lambda t: t.named), named))
        over = _ratio(some, "before")
        rows.append(
            (
                f"outside, {words}: after / before, median and largest",
                len(some),
                quantiles(over, 0.5, 1.0),
                f"{ratio}, 1.05",
            )
        )
        for name, right in drivers.items():
            own = [t for t in some if t.job.outside and t.job.outside[0] == name]
            mark = (">= 90 %", "0 %") if words == "strong" else ("-", "-")
            said = share(own, partial(_drives, right=right))
            rows.append((f"{words} {name}: driver right", len(own), said, mark[0]))
            silent = share(own, lambda t: not t.alarm)
            rows.append((f"{words} {name}: nothing missing", len(own), silent, mark[1]))
    return rows


def _drives(trial: Trial, right: str) -> bool:
    return any(driver and driver in right for _, driver in trial.unexplained)


def _confounded(trials: Trials) -> list[Row]:
    some = _of(trials, "confounded")
    if not some:
        return []
    strong = [t for t in some if t.sets]
    return [
        (
            "confounded: truth in the set, where a set is given",
            len(strong),
            share(strong, lambda t: t.within),
            ">= 98 %",
        ),
        ("confounded: another name alone", len(some), share(some, lambda t: t.wrong), "0 %"),
    ]


def _absorbed(trials: Trials) -> list[Row]:
    silent = set(array_world.ABSORBED)
    said = share(trials, lambda t: silent <= set(t.absorbed))
    return [("absorbed effects: all listed with what they would do", len(trials), said, "100 %")]


def _rest(trials: Trials) -> list[Row]:
    usual = [t for t in trials if t.intervals and not t.job.outside and t.job.noise == "gaussian"]
    hits, count = sum(t.covered for t in usual), sum(t.intervals for t in usual)
    seconds = quantiles((t.seconds for t in trials), 0.5, 0.9)
    cover = f"{100.0 * hits / count:.1f} % ({hits}/{count})" if count else "-"
    return [
        ("95 % intervals of the final parameters cover", len(usual), cover, "90-97 %"),
        ("CPU s a run, median and 90 %", len(trials), seconds, "<= 20 at 32 IMUs, T = 500"),
    ]
