"""Damage to bytes: what disks, cables, editors and dying batteries do to a file."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

Bytes = bytes | bytearray


def damaged(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    """The data after one to three kinds of damage, and what was done.

    edges : where the format's own units begin (records, sectors, rows); a third of the damage
    begins and ends there, where no structure tells it
    """
    out, said = data, []
    for _ in range(rng.choices((1, 2, 3), (8, 1, 1))[0]):
        kind = rng.choice(list(KINDS))
        before = out
        for _ in range(20):
            out, where = KINDS[kind](before, rng, edges if rng.random() < 0.33 else ())
            if out != before:
                break
        said.append(f"{kind} {where}")
    return out, ", ".join(said)


def _span(data: Bytes, rng: random.Random, edges: Sequence[int]) -> tuple[int, int]:
    """First byte and end of a stretch: of whole units where there are edges."""
    inside = [e for e in edges if 0 <= e <= len(data)]
    if len(inside) > 1:
        first = rng.randrange(len(inside) - 1)
        last = min(len(inside) - 1, first + 1 + int(rng.expovariate(0.7)))
        return inside[first], inside[last]
    start = rng.randrange(max(1, len(data)))
    return start, min(len(data), start + 1 + int(2 ** rng.uniform(0, 11)))


def _cut(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    at = max(1, _span(data, rng, edges)[0])
    return data[:at], f"at {at}"


def _flip(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    out, where = bytearray(data), []
    for _ in range(rng.choices((1, 2, 4), (6, 2, 2))[0]):
        at = rng.randrange(len(out))
        out[at] ^= 1 << rng.randrange(8)
        where.append(str(at))
    return bytes(out), "bits of " + " ".join(where)


def _overwrite(fill: Callable[[random.Random, int], bytes]) -> Callable[..., tuple[bytes, str]]:
    def done(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
        a, b = _span(data, rng, edges)
        return data[:a] + fill(rng, b - a) + data[b:], f"{a} to {b}"

    return done


def _insert(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    a, b = _span(data, rng, edges)
    return data[:a] + rng.randbytes(b - a) + data[a:], f"{b - a} at {a}"


def _repeat(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    (a, b), (at, _) = _span(data, rng, edges), _span(data, rng, edges)
    return data[:at] + data[a:b] + data[at:], f"{a} to {b} at {at}"


def _delete(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    a, b = _span(data, rng, edges)
    return data[:a] + data[b:], f"{a} to {b}"


def _swap(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    (a, b), (c, d) = sorted((_span(data, rng, edges), _span(data, rng, edges)))
    if b > c:
        return data, "nothing"
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:], f"{a} to {b}, {c} to {d}"


def _append(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    if rng.random() < 0.5:
        return data + data, "the file itself"
    return data + rng.randbytes(rng.randrange(1, 3000)), "noise"


_WORDS = (b" PM", b" AM", b" a.m.", b" CET", b" CST", b"Z", b"+01:00", b"+02", b"-99", b"T",
          b" 30.02.2023", b"2023-02-30 25:61:61", b"NaT", b"Feb", b"12:00", b"-", b'"',
          b"\0")  # fmt: skip


def _word(data: bytes, rng: random.Random, edges: Sequence[int]) -> tuple[bytes, str]:
    """A word of a clock where it does not belong: before a comma or a unit, or over a cell."""
    at = _span(data, rng, edges)[0]
    comma = data.find(b",", at)
    at = comma if comma >= 0 and rng.random() < 0.7 else at
    word = rng.choice(_WORDS)
    over = rng.choice((0, 0, len(word)))
    return data[:at] + word + data[at + over :], f"{word!r} at {at}"


KINDS: dict[str, Callable[..., tuple[bytes, str]]] = {
    "cut": _cut,
    "flip": _flip,
    "insert": _insert,
    "repeat": _repeat,
    "delete": _delete,
    "swap": _swap,
    "zero": _overwrite(lambda _, n: bytes(n)),
    "ones": _overwrite(lambda _, n: b"\xff" * n),
    "noise over": _overwrite(lambda rng, n: rng.randbytes(n)),
    "append": _append,
    "word": _word,
}
