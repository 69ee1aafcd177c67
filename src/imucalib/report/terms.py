"""The words of the reports that a reader may not know, and what they mean."""

from __future__ import annotations

TERMS: tuple[tuple[str, str], ...] = (
    ("mg", "a thousandth of standard gravity, 0.00980665 m/s²"),
    ("|a|", "the size of the measured acceleration; at rest it is local gravity"),
    ("raw, base, final", "the reading as it came; corrected by the usual parameters; corrected by "
     "these and by what the search found"),
    ("held out", "on data that took no part: searched and fitted without them, then predicted"),
    ("noise floor", "what noise alone would leave, from positions that repeat or as declared"),
    ("sd, ±", "one standard deviation; 95 %: an interval that holds the truth 19 times of 20"),
    ("p", "the chance that the best of all candidates does as well on data that lack nothing"),
    ("nats", "evidence: e to that power is how much more probable the data are with the effect"),
    ("explained, suspected", "the gain on held-out data excludes zero, or does not yet"),
    ("cannot be told from", "effects that do the same to these data; a name stays open, the "
     "correction averages over them"),
    ("left (%), λ", "share of an effect that the fitted parameters do not take up, and its "
     "strength over the noise: about 4.7 is found four times of five"),
    ("bias, scale, cross", "reading at zero; sensitivity minus one; what one axis reads of "
     "another's acceleration (non-orthogonality)"),
    ("posture run", "a stretch at rest in one posture, taken as one observation"),
    ("tool-face, inclination", "roll about the tool's axis, and its angle from the horizontal"),
)  # fmt: skip
