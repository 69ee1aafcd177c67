"""What an array's motion could lack, as components with their columns at a fitted motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Index
from imucalib.calibrators.array.loop.ages import PHASE, phases_of
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.calibrators.array.loop.laws import array_functions, array_laws
from imucalib.calibrators.array.loop.motion import BoardMotion
from imucalib.calibrators.array.loop.terms import Term, columns_of
from imucalib.core.effect import Response
from imucalib.estimators.array.gram import Columns
from imucalib.loop.posterior.component import Component, Kind, Member
from imucalib.loop.posterior.odds import TOGETHER


@dataclass(frozen=True)
class Way:
    """A member as the array's model takes it in: an effect of all IMUs, or of one; part : its
    columns among those of its block"""

    name: str
    effect: Response
    only: int | None
    block: int
    part: Index


@dataclass(frozen=True)
class Components:
    """components, with a way for each of their members in order; columns : (blocks,) in typical
    sizes; missing : why effects could not be tried"""

    components: tuple[Component, ...]
    ways: tuple[tuple[Way, ...], ...]
    columns: tuple[Columns, ...]
    missing: dict[str, str]


def components_of(
    motion: BoardMotion, terms: tuple[Term, ...], left_out: frozenset[str]
) -> Components:
    """Every effect and every law.

    terms : of the model; where one has a twin in it, that stands for both; left_out : names that
    are not tried
    """
    every, missing = _every(motion, terms)
    blocks, found = list[Columns](), list[tuple[Component, tuple[Way, ...]]]()
    for name, (kind, driver, forms) in every.items():
        members, ways = list[Member](), list[Way]()
        for effect in forms:
            own = _ways(effect, motion.context.triads, len(blocks))
            columns = _owned(effect, motion)
            kept = [(way, share) for way, share in own if way.name not in left_out]
            if kept and np.isfinite(columns.basis).all() and columns.basis.any():
                blocks.append(columns)
                ways += [way for way, _ in kept]
                members += [_member(way, share) for way, share in kept]
        if ways:
            share = np.log(sum(np.exp(m.log_weight) for m in members))
            fair = (replace(m, log_weight=float(m.log_weight - share)) for m in members)
            found.append((Component(name, kind, tuple(fair), driver), tuple(ways)))
    return Components(
        tuple(c for c, _ in found), tuple(w for _, w in found), tuple(blocks), missing
    )


Forms = tuple[Kind, str, list[Response]]


def _every(motion: BoardMotion, terms: tuple[Term, ...]) -> tuple[dict[str, Forms], dict[str, str]]:
    """Kind, driver and effects of every component, and why others cannot be tried."""
    every, missing = dict[str, Forms](), dict[str, str]()
    held = [term.effect for term in terms]
    for effect in array_catalogue().values():
        if effect.twin:
            continue
        reason = effect.missing(motion.context)
        if reason:
            missing[effect.name] = reason
        else:
            stands = next((e for e in held if e.twin == effect.name), effect)
            every[effect.name] = "name", "", [stands]
    # Their ranges are the motion's: what is in the model stays as it is there.
    same = {effect.name: effect for effect in held}
    for driver, law in array_laws(motion):
        if not law.missing(motion.context):
            forms = every.setdefault(f"another law of {driver}", ("law", driver, []))[2]
            forms.append(same.get(law.name, law))
    for driver, function in array_functions(motion):
        every[function.name] = "free", driver, [same.get(function.name, function)]
    return every, missing


def _ways(effect: Response, imus: tuple[str, ...], block: int) -> Iterator[tuple[Way, float]]:
    """All IMUs together and one alone, each with its share in logs."""
    size, each = len(effect.each), len(effect.each) * len(imus)
    if effect.shared:
        owned = size + (len(imus) * len(phases_of(effect).each) if _aged(effect) else 0)
        yield Way(effect.name, effect, None, block, np.arange(owned)), 0.0
        return
    yield Way(effect.name, effect, None, block, np.arange(each)), float(np.log(TOGETHER))
    for k, imu in enumerate(imus):
        part = np.arange(k * size, (k + 1) * size)
        share = float(np.log((1.0 - TOGETHER) / len(imus)))
        yield Way(f"{effect.name}@{imu}", effect, k, block, part), share


def _member(way: Way, share: float) -> Member:
    each = np.array([p.typical for p in way.effect.each])
    effect = replace(way.effect, name=way.name)
    return Member(((effect, way.part, np.resize(each, way.part.size)),), share)


def typical_columns(effect: Response, motion: BoardMotion, only: int | None = None) -> Columns:
    """Its columns in units of typical sizes, of all IMUs or of one."""
    columns = columns_of(effect, motion, only)
    columns.basis[...] *= np.array([p.typical for p in effect.each])
    return columns


def _owned(effect: Response, motion: BoardMotion) -> Columns:
    """The same with what belongs to it: of clocks what their phases leave of each gyro."""
    own = typical_columns(effect, motion)
    if not _aged(effect):
        return own
    phases = PHASE * typical_columns(phases_of(effect), motion).basis
    k, t, _, m = phases.shape
    apart = np.zeros((k, t, 3, k, m))
    apart[np.arange(k), :, :, np.arange(k)] = phases
    basis = np.concatenate([own.basis, apart.reshape(k, t, 3, k * m)], axis=3)
    return Columns(basis, own.gyro, own.shared)


def _aged(effect: Response) -> bool:
    return "sample_age" in effect.needs
