"""What no name says is corrected where blocks of time foretell it, and stays without a name."""

from __future__ import annotations

from types import ModuleType

import pytest

from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.loop.found import LoopSettings

WANTED = ActigraphRequest()


@pytest.mark.parametrize(
    ("effect", "by", "told"),
    [
        ("scale_swing", "shape@scale:time:sine:", "the scale swings with a period of 7 h"),
        ("bias_swing", "shape@bias:time:sine:", "the bias swings with a period of 7 h"),
        ("scale_walk", "curve@scale:time:", "the scale moves with time"),
        ("slow_walk", "curve@bias:time:", "the bias wanders by 2.2 mg in 24 h"),
        ("shock", "curve@bias:time:", "the bias wanders by 2.2 mg in 6 h"),
    ],
    ids=["scale swing", "bias swing", "scale walk", "slow walk", "shock"],
)
def test_structure_is_corrected_and_told(worn: ModuleType, effect: str, by: str, told: str) -> None:
    case = worn.Case("white", effect, 60.0, 7000)
    result = case.solved(WANTED)
    loop = result.loop
    (step,) = loop.curves
    assert step.effect.startswith(by)
    assert not step.certain
    assert told in {one.name for one in loop.unexplained}
    assert loop.verdict in ("unexplained", "explained in part")
    assert loop.difference.gain > 0.0
    assert case.error(result.final) < 0.5 * case.error(result.base)


@pytest.mark.parametrize(
    "request_",
    [
        ActigraphRequest(rules=LoopSettings(curves=False)),
        ActigraphRequest(without=("curve",)),
    ],
    ids=["no curves", "without"],
)
def test_who_wants_no_curves_is_told_alone(worn: ModuleType, request_: ActigraphRequest) -> None:
    loop = worn.Case("white", "scale_swing", 60.0, 7000).solved(request_).loop
    assert not loop.curves
    assert "the scale swings with a period of 7 h" in {one.name for one in loop.unexplained}


@pytest.mark.parametrize("effect", ["scale_swing", "bias_swing"])
def test_what_swings_within_a_part_no_part_follows(worn: ModuleType, effect: str) -> None:
    case = worn.Case("white", effect, 60.0, 7000)
    daily = case.solved(ActigraphRequest(every=86400.0))
    assert [step.effect.partition(":sine:")[0] for step in daily.loop.curves] == [
        f"shape@{effect.partition('_')[0]}:time"
    ]
    assert case.error(daily.final) < 0.5 * case.error(daily.base)
    assert not case.solved(ActigraphRequest(every=6 * 3600.0)).loop.curves


@pytest.mark.parametrize("effect", ["scale_walk", "slow_walk", "scale_jump"])
def test_what_parts_follow_no_curve_does(worn: ModuleType, effect: str) -> None:
    loop = worn.Case("white", effect, 60.0, 7000).solved(ActigraphRequest(every=86400.0)).loop
    assert not loop.curves
    assert loop.unexplained


def test_a_walk_of_the_size_of_the_scatter_is_noise(worn: ModuleType) -> None:
    result = worn.Case("walk 12 h", "", 0.0, 7001).solved(WANTED)
    assert "the bias wanders" in result.loop.unexplained[0].name
    assert not result.loop.steps
