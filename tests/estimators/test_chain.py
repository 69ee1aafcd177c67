"""Unknowns along a chain, taken out rest by rest, against the whole matrix."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.estimators.chain import chain_of, eliminate, turns_of


@settings(max_examples=40, deadline=None)
@given(
    rests=st.integers(2, 9),
    shared=st.integers(1, 6),
    width=st.integers(1, 5),
    missing=st.integers(0, 8),
    seed=st.integers(0, 2**32 - 1),
)
def test_what_is_left_is_the_schur_complement(
    rests: int, shared: int, width: int, missing: int, seed: int
) -> None:
    """With any order of the columns, turns that are missing, and for many weights at a time."""
    rng = np.random.default_rng(seed)
    size = shared + rests * width
    places = rng.permutation(size)
    own, order = places[:shared], places[shared:].reshape(rests, width)
    fixed = np.zeros((size + 3 * rests, size))  # what is known of each, and of a rest and the next
    fixed[:size] = np.eye(size)
    for k in range(rests):
        near = np.concatenate([own, order[k], order[min(k + 1, rests - 1)]])
        fixed[size + 3 * k : size + 3 * k + 3, near] = rng.normal(size=(3, len(near)))
    at = np.delete(np.arange(rests - 1), min(missing, rests - 2)) if rests > 2 else np.arange(1)
    turns = np.zeros((len(at), 2, size))
    for row, k in zip(turns, at, strict=True):
        near = np.concatenate([own, order[k], order[k + 1]])
        row[:, near] = rng.normal(size=(2, len(near)))
    normal, flat = fixed.T @ fixed, turns.reshape(-1, size)
    weight = rng.uniform(0.0, 5.0, (3, len(at)))
    heavy = np.zeros((3, rests - 1))
    heavy[:, at] = weight
    left, logs = eliminate(chain_of(normal, order, own), turns_of(flat, at, order, own), heavy)
    out = order.ravel()
    for w, found, log in zip(weight, left, logs, strict=True):
        whole = normal + flat.T @ (np.repeat(w, 2)[:, None] * flat)
        inner, across = whole[np.ix_(out, out)], whole[np.ix_(out, own)]
        expected = whole[np.ix_(own, own)] - across.T @ np.linalg.solve(inner, across)
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(2.0 * log, np.linalg.slogdet(inner)[1], rtol=1e-9, atol=1e-9)
