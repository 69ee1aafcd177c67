"""What a search beside a walk says of an effect, by the numbers behind it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucalib.errors import NotConverged
from imucalib.loop.found import Step, Unexplained, Wander
from imucalib.loop.wander import confirm, engine, words
from imucalib.loop.wander.choice import Search, Taken
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.scores import Entry
from imucalib.loop.wander.words import (
    aliases,
    beside_left,
    chance_of,
    looked_like,
    scores_of,
    unexplained,
)
from imucalib.units import MG


def scored(name: str, evidence: float, columns: tuple[int, ...], **more: object) -> SimpleNamespace:
    entry: dict[str, Any] = {"family": "", "kind": "time" if more.get("timed") else "effect"}
    made = {
        "evidence": evidence,
        "walk": 0,
        "size": 0.7,
        "left": 0.9,
        "strength": 3.0,
        "share": 0.1,
    }
    entry |= {k: v for k, v in more.items() if k in entry}
    made |= {k: v for k, v in more.items() if k in made}
    return SimpleNamespace(entry=Entry(name, columns=np.array(columns), **entry), **made)


def test_p_counts_the_draws_that_do_as_well_in_one_of_two_halves() -> None:
    chance = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], [9.0] * 7])
    assert chance_of(scored("a", 6.5, (0,)), chance) == pytest.approx(2.0 * 2.0 / 8.0)  # type: ignore[arg-type]
    assert chance_of(scored("a", 6.0, (0,)), chance) == pytest.approx(2.0 * 3.0 / 8.0)  # type: ignore[arg-type]
    assert chance_of(scored("a", 8.0, (0,), timed=True), chance) == 1.0  # type: ignore[arg-type]
    assert chance_of(scored("a", 9.5, (0,), timed=True), chance) == pytest.approx(0.25)  # type: ignore[arg-type]


def test_of_a_scan_only_the_best_is_a_score_and_curves_all_are() -> None:
    columns = np.array([[3.0, 1.0, 0.0], [4.0, 1.0, 2.0]])
    problem = SimpleNamespace(
        bank=SimpleNamespace(columns=columns), noise=SimpleNamespace(scatter=2.0)
    )
    found = [
        scored("lag@1h", 8.0, (0,), family="lag"), scored("lag@2h", 7.0, (1,), family="lag"),
        scored("curve@x", 6.0, (1, 2), family="curve", kind="curve"),
        scored("curve@y", 5.0, (2,), family="curve", kind="curve"),
        scored("plain", 4.0, (2,), timed=True), scored("other", 3.0, (1,)),
    ]  # fmt: skip
    chance = np.array([[7.5, 1.0, 1.0], [6.5, 1.0, 1.0]])
    scores = scores_of(problem, found, chance, np.array([2.5, 3.5]))  # type: ignore[arg-type]
    assert [s.candidate.name for s in scores] == ["lag@1h", "curve@x", "curve@y", "plain", "other"]
    assert scores[0].size == pytest.approx(5.0 / np.sqrt(2.0) * 2.0 * MG)
    assert scores[1].size == pytest.approx(np.sqrt(6.0 / 2.0) * 2.0 * MG)
    assert [s.p for s in scores] == pytest.approx([0.5, 1.0, 1.0, 1.0, 1.0])
    assert [s.bar for s in scores] == [2.5, 2.5, 2.5, 3.5, 2.5]
    assert {s.draws for s in scores} == {3}


def apart_by_hand(white: np.ndarray, own: int, rival: int, size: float) -> float:
    """Ridge of the data on the effect beside the base; what the rival and the base leave of it."""
    base, y = white[:, :2], white[:, 6]
    residual = np.eye(len(white)) - base @ np.linalg.pinv(base)
    x = residual @ white[:, [own]]
    stacked = np.vstack([x, np.eye(1) / size])
    theta = np.linalg.lstsq(stacked, np.append(residual @ y, 0.0), rcond=None)[0]
    effect = x @ theta
    both = np.column_stack([base, white[:, rival]])
    return float(np.linalg.norm(effect - both @ np.linalg.lstsq(both, effect, rcond=None)[0]))


def test_rivals_are_near_in_evidence_or_in_angle() -> None:
    rng = np.random.default_rng(4)
    white = rng.standard_normal((30, 7))
    # Columns 3, 4, 5 are the effect of column 2 and more and more of another; 6 are the data.
    white[:, 6] = 3.0 * white[:, 2] + 0.3 * white[:, 6]
    for k, share in ((3, 0.05), (4, 0.1), (5, 3.0)):
        white[:, k] = white[:, 2] + share * white[:, k]
    far = [apart_by_hand(white, 2, k, 0.7) for k in (3, 4, 5)]
    limit = 2.0 / float(np.mean(far[:2]))  # the first below two, the second above
    assert far[0] < far[1] < far[2]
    white[:, 6] *= limit
    far = [apart_by_hand(white, 2, k, 0.7) for k in (3, 4, 5)]
    assert far[0] < 2.0 < far[1]
    bank = SimpleNamespace(white=lambda _, at: white[:, at], data=6)
    own = scored("own", 20.0, (2,), family="fam")
    rivals = [
        scored("own", 20.0, (2,)), scored("sibling@1", 19.0, (3,), family="fam"),
        scored("even", 17.0, (5,)), scored("less", 16.9, (5,)), scored("close", 10.0, (3,)),
        scored("closer", 9.9, (3,)), scored("wide", 16.0, (4,)), scored("scan@1", 12.0, (3,)),
        scored("scan@2", 11.0, (3,)), scored("converter@x", 20.0, (3,), kind="curve"),
        scored("posture@24", 16.9, (3,), kind="posture"),
        scored("posture@80", 17.0, (5,), kind="posture"),
        scored("curve@bias:temperature:1:2:4", 16.9, (3,), kind="temperature"),
    ]  # fmt: skip
    taken = SimpleNamespace(found=own, rivals=rivals)
    taken.alike = ("posture@24",)
    terms = Terms(np.array([0, 1]), np.zeros(2), 2)
    found = aliases(bank, terms, taken)  # type: ignore[arg-type]
    assert found == ("even", "close", "scan@1", "posture@80")


@pytest.mark.parametrize(
    ("nats", "alike", "told"),
    [(17.0, False, True), (12.0, True, True), (12.0, False, False), (9.0, True, False)],
)
def test_a_free_function_is_anothers_rival_where_it_does_as_well_on_blocks_left_out(
    nats: float, alike: bool, told: bool
) -> None:
    """Half of the evidence at least; without the blocks within three nats."""
    own = scored("converter@xyz", 20.0, (2,), kind="curve", family="converter")
    rival = scored("posture@80", nats, (3,), kind="posture", family="posture")
    taken = SimpleNamespace(found=own, rivals=(rival,), alike=("posture@80",) if alike else ())
    white = np.random.default_rng(1).standard_normal((20, 5))
    bank = SimpleNamespace(white=lambda _, at: white[:, at], data=4)
    found = aliases(bank, Terms(np.arange(2), np.ones(2), 2), taken)  # type: ignore[arg-type]
    assert found == (("posture@80",) if told else ())


def test_what_gravity_shows_as_a_part_of_an_effect_would_do_as_well() -> None:
    """Squares of the forces across an axis are columns of cross_axis in the norm."""
    found = SimpleNamespace(found=scored("cross_axis", 300.0, (2,)), rivals=(), alike=())
    bank, terms = SimpleNamespace(white=np.zeros((1, 3, 3))), Terms(np.arange(2), np.ones(2), 2)
    assert aliases(bank, terms, found) == ("squares_across",)  # type: ignore[arg-type]
    found.found = scored("squares_across", 300.0, (2,))
    assert aliases(bank, terms, found) == ("cross_axis",)  # type: ignore[arg-type]
    found = SimpleNamespace(found=scored("cubic", 300.0, (2,)), rivals=())
    assert aliases(bank, terms, found) == ()  # type: ignore[arg-type]


def test_a_response_beside_a_free_one_has_another_form_than_its_name() -> None:
    kinds = {
        "cubic": "shape",
        "converter@x": "curve",
        "posture@24": "posture",
        "lag": "temperature",
    }
    made = [scored(name, 20.0, (0,), kind=kind) for name, kind in kinds.items()]
    every = [Taken(one, 1.0, np.zeros(2), 2.0, 1.0, ()) for one in made]  # type: ignore[arg-type]
    found = [words._beside(one, every) for one in every]
    assert found == [("converter@x", "posture@24"), ("cubic", "posture@24"), ("converter@x",), ()]


@pytest.mark.parametrize(
    ("name", "nats", "told"),
    [
        ("thermal_lag@1h", 30.5, True), ("thermal_lag@1h", 29.5, False),
        ("thermal_hysteresis@2C", 30.5, True), ("temperature_rate@2min", 30.5, True),
        ("temperature_scale", 36.5, False),
    ],
)  # fmt: skip
def test_a_past_of_the_temperature_leads_its_present_by_ten_nats(
    name: str, nats: float, told: bool
) -> None:
    """Of a bias that follows the temperature one in twelve was surely a lag."""
    own = scored(name, 40.0, (2,), kind="temperature", family=name.partition("@")[0])
    rival = scored("temperature_bias", nats, (3,), kind="temperature")
    taken = SimpleNamespace(found=own, rivals=(own, rival), alike=())
    white = np.random.default_rng(1).standard_normal((20, 5))
    bank = SimpleNamespace(white=lambda _, at: 100.0 * white[:, at], data=4)
    terms = Terms(np.arange(2), np.ones(2), 2)
    found = aliases(bank, terms, taken)  # type: ignore[arg-type]
    assert found == (("temperature_bias",) if told else ())


@pytest.mark.parametrize(
    ("names", "unsure"),
    [
        (("thermal_lag@1h",), []),
        (("thermal_lag@1h", "bias_drift"), []),
        (("temperature_bias", "temperature_rate@2min"), ["temperature_rate@2min"]),
        (("thermal_hysteresis@2C", "thermal_lag@1h"), ["thermal_hysteresis@2C", "thermal_lag@1h"]),
    ],
)
def test_the_past_of_the_temperature_beside_the_temperature_may_be_another_past(
    names: tuple[str, ...], unsure: list[str]
) -> None:
    """A play of 1.4 °C was surely one of 2 °C and surely a lag of half an hour."""
    kinds = ["time" if name == "bias_drift" else "temperature" for name in names]
    made = [scored(n, 20.0, (0,), kind=k) for n, k in zip(names, kinds, strict=True)]
    every = [Taken(one, 1.0, np.zeros(2), 2.0, 1.0, ()) for one in made]  # type: ignore[arg-type]
    told = [name for name, one in zip(names, every, strict=True) if words._beside(one, every)]
    assert told == unsure
    assert {a for one in every for a in words._beside(one, every)} <= {"unlisted_effect"}


def test_what_leaves_readings_without_an_inverse_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last of the response goes first; a temperature stays."""
    kinds = {"posture@24": "posture", "lag": "temperature", "cubic": "shape"}
    made = [scored(name, 20.0, (k,), kind=kind) for k, (name, kind) in enumerate(kinds.items())]
    taken = tuple(Taken(one, 1.0, np.zeros(2), 2.0, 1.0, ()) for one in made)  # type: ignore[arg-type]
    terms, plain = Terms(np.arange(1), np.ones(1), 1), SimpleNamespace(theta=np.zeros(9))
    bank = SimpleNamespace(course=SimpleNamespace(parts=2))
    monkeypatch.setattr(confirm, "best_level", lambda *_: "level")

    def final(found: engine._Pass) -> Any:
        if any(t.found.entry.kind == "posture" for t in found.search.taken):
            raise NotConverged("no inverse")
        return "fit", "precision"

    monkeypatch.setattr(engine, "_final", final)
    found = Search(bank, terms, None, taken, (), (), ())  # type: ignore[arg-type]
    problem = SimpleNamespace(terms=terms, fit=plain)
    done, *rest = engine._undoable(engine._Pass(problem, None, (), (), found))  # type: ignore[arg-type]
    assert rest == ["fit", "precision"]
    assert [t.found.entry.name for t in done.search.taken] == ["lag"]
    assert [r.name for r in done.search.refused] == ["cubic", "posture@24"]
    assert all("no inverse" in r.reason for r in done.search.refused)


@pytest.mark.parametrize(
    ("size", "evidence", "told"), [(2.0, 5.1, True), (2.0, 4.9, False), (0.9, 9.0, False)]
)
def test_a_walk_is_told_beyond_five_nats_and_the_scatter_of_a_run(
    size: float, evidence: float, told: bool
) -> None:
    found = unexplained(Wander(size, 3.0, 1.0, evidence))
    assert bool(found) == told
    for one in found:
        assert one.p == pytest.approx(np.exp(-evidence))
        assert one.share == pytest.approx(0.8)
        assert one.evidence == evidence


@pytest.mark.parametrize(("evidence", "told"), [(10.1, ["bias_step"]), (9.9, [])])
def test_what_was_refused_is_told_where_no_bar_lets_so_much_through(
    evidence: float, told: list[str]
) -> None:
    """The strongest alone, with the reason, what drives it, and its chance."""
    weak, strong = (scored(name, nats, (0,)) for name, nats in (("cubic", 9.0), ("at", evidence)))
    refused = [
        SimpleNamespace(name="cubic", found=weak, reason="small"),
        SimpleNamespace(name="bias_step", found=strong, reason="it does not hold out"),
    ]
    chance = np.array([[1.0, 2.0, 12.0], [0.0, 0.0, 0.0]])
    drivers = {"at": "time", "cubic": ""}
    found = looked_like(refused, (), chance, drivers.__getitem__)  # type: ignore[arg-type]
    assert [u.name for u in found] == [
        f"what looks like {name} and was not taken: it does not hold out" for name in told
    ]
    for one in found:
        assert (one.driver, one.kind, one.evidence) == ("time", "probe", evidence)
        assert one.p == pytest.approx(2.0 * 2.0 / 4.0)


def test_what_a_step_calls_its_alias_is_no_structure_of_its_own() -> None:
    """A drift that may be a step; of what else was refused, the scan by its family's name."""
    steps = (SimpleNamespace(aliases=("bias_step@3600s", "warm_up")),)
    names = {"bias_step@7200s": "bias_step@7200s", "thermal_lag": "thermal_lag@1h"}
    refused = [
        SimpleNamespace(name=name, reason="so", found=scored(member, 20.0 - k, (0,)))
        for k, (name, member) in enumerate(names.items())
    ]
    chance = np.zeros((2, 9))
    (left,) = looked_like(refused, steps, chance, str.upper)  # type: ignore[arg-type]
    assert left.name == "what looks like thermal_lag and was not taken: so"
    assert left.driver == "THERMAL_LAG@1H"
    (first,) = looked_like(refused, (), chance, str.upper)  # type: ignore[arg-type]
    assert first.name.startswith("what looks like bias_step@7200s")


def test_a_first_step_has_its_rivals_beside_what_came_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each of two is scored with the other in the model, and what does as well then is its alias;
    a scan of which a value was taken is no rival, and one step alone is as it was."""
    lag, warm = scored("lag@3h", 40.0, (3,), family="lag"), scored("warm", 10.0, (4,))
    other, near = scored("lag@2h", 0.0, (5,), family="lag"), scored("step", 0.0, (6,))
    seen = list[tuple[list[int], list[str]]]()

    def score(
        _: object, terms: Terms, __: object, entries: list[Any], *___: object, told: bool
    ) -> Any:
        seen.append((terms.columns.tolist(), [e.name for e in entries]))
        return [SimpleNamespace(entry=e) for e in entries], None

    monkeypatch.setattr(words, "scored", score)
    monkeypatch.setattr(words, "usable_walks", lambda *_, **__: ())
    monkeypatch.setattr(
        words, "aliases", lambda _, __, taken: ("step",) if taken.found.entry is lag.entry else ()
    )
    problem = SimpleNamespace(
        entries=[x.entry for x in (lag, other, warm, near)],
        terms=Terms(np.arange(3), np.ones(3), 3),
    )
    bank = SimpleNamespace(course=SimpleNamespace(parts=2))
    taken = tuple(Taken(x, 1.0, np.zeros(2), 2.0, 1.0, ()) for x in (lag, warm))
    steps = tuple(Step(x.entry.name, 0.01, 99, x.evidence, (), ("cubic",)) for x in (lag, warm))
    search = SimpleNamespace(taken=taken, bank=bank, level=None)
    found = words.beside_others(problem, search, steps)  # type: ignore[arg-type]
    assert [s.aliases for s in found] == [("cubic", "step"), ("cubic",)]
    assert seen == [([0, 1, 2, 4], ["lag@3h", "step"]), ([0, 1, 2, 3], ["warm", "step"])]
    search.taken = taken[:1]
    assert words.beside_others(problem, search, steps[:1]) == steps[:1]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("driver", "kind", "nats", "share", "doubted"),
    [
        ("time", "swing", 12.0, 0.1, ("time",)),
        ("temperature", "course", 12.0, 0.1, ("temperature",)),
        ("time", "swing", 60.0, 0.1, ("time", "temperature")),
        ("time", "stretch", 60.0, 0.0, ()),
        ("order", "noise", 500.0, 0.5, ()),
    ],
)
def test_a_name_is_in_doubt_beside_what_its_driver_or_more_than_it_leaves(
    driver: str, kind: str, nats: float, share: float, doubted: tuple[str, ...]
) -> None:
    """A daily swing before and after the clock was set was a certain time_of_day."""
    entries = [Entry(k, "", k, np.arange(1)) for k in ("time", "temperature")]
    found = SimpleNamespace(
        taken=[SimpleNamespace(found=SimpleNamespace(entry=e)) for e in entries]
    )
    steps = [Step(e.name, 0.001, 99, 50.0, (), ()) for e in entries]
    left = (Unexplained("what is left", driver, kind, 1e-4, nats, share),)
    told = beside_left(found, steps, left)  # type: ignore[arg-type]
    assert tuple(s.effect for s in told if s.aliases == ("unlisted_effect",)) == doubted
    assert [s.certain for s in told] == [s.effect not in doubted for s in told]
