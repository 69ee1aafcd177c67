"""The numbers that decide what a search says, in one place, each with where it comes from.

Rows of measured rates are those of benchmarks/RESULTS.md, "The closed loop", which `make
loop-benchmark` writes again.
"""

from __future__ import annotations

#: Family-wise p up to which an effect without aliases is called certain: of clean recordings 0.8,
#: 0.2 and 0.5 % held such a name. So much is told too where it is not taken, since the data that
#: were left out refuse it: of 400 clean sheets none had such a one, of 135 with λ 6 to 10 two.
CERTAIN = 0.01
#: Share of a candidate's columns that the fitted parameters must leave for it to be testable: what
#: is left below is rounding (columns of 1e3 numbers at 1e-16 leave about 1e-13).
ABSORBED = 1e-5
#: λ sin(angle) below which two effects are not told apart: the difference of two maxima of χ² is
#: then within two standard deviations of zero.
APART = 2.0
#: Nats by which a curve must beat the best effect to be weighed beside it: odds of 20.
MARGIN = 3.0
#: Nats from which on an effect that data refuse which took no part is structure without a name, not
#: one of the accidents of which ALPHA allows a few: odds of e^10 are no accident.
STRONG = 10.0
