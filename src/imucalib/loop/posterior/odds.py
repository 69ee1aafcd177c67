"""Every number that decides in the posterior, each with its source.

"simulated" : set on simulated recordings that lack nothing, so that one or two of a hundred claim
something (`benchmarks/closed_loop`). No other file of this room holds a number that decides.
"""

from __future__ import annotations

import numpy as np

#: Prior odds that a recording lacks something: .70 ± .17 of twelve measured instruments did, by
#: their Bayes factors (`benchmarks/prior_odds.py`).
MISSING = 2.4
#: Share of these odds of all names and free functions together, and of loose scans, where no
#: physics speaks for one value before another; simulated.
KNOWN, LOOSE = 0.4, 0.05
#: Prior odds that a sheet has a slip, shared by the classes of slips, of which a record that
#: belongs nowhere is one; and odds from which on one is told: likelier than not; simulated.
WRONG, SLIPS, ACCUSED = 0.1, 6.0, 1.0
#: Share of a name's odds that all of its parameters act together; the rest is one alone. Most
#: effects of chips act on every axis.
TOGETHER = 0.6
#: Sizes of a component over the noise factor: nine octaves from what no data show to ten times what
#: data sheets give.
SIZES = 2.0 ** np.arange(-2.0, 7.0)
#: Above its typical size a component's density falls as a log-normal of this factor: data sheets
#: quote what most devices stay below. Below it is flat: a size centred there made trifles certain.
SPREAD = 3.5
#: What claiming something that is not there costs over missing something that is: less than two of
#: a hundred clean worlds claim anything; simulated.
FALSE_CLAIM = 5.0
#: Probability of a model from which on intervals hold it.
LEAST = 0.005
#: Probability above which a name is certain.
CERTAIN = 0.95
#: Share of a candidate's columns that the fitted parameters must leave for it to be seen: what is
#: left below is rounding (columns of 1e3 numbers at 1e-16 leave about 1e-13).
ABSORBED = 1e-5
#: Nats by which the best set must lead a simpler one that is told (Occam's window; Raftery 1995).
OCCAM = 3.0
#: Nats below the best at which a set is opened no further, and below which a noise is dropped.
OPEN, HEARD = 9.0, 12.0
#: Times what hands usually set an angle to beyond which a scatter is none: 3 deg.
FAR = 10.0
#: Records that may be wrong, each by a gross error, while noises are dropped.
GROSS = 3
#: Size of what a model may lack at most, over the noise, while noises are dropped.
REACH = 4.0
#: Sets that are opened at each depth, and the most components of one.
BEAMS, DEEPEST = (8, 5, 3), 4
#: Sets that are opened where a search climbs from a set: 1, 2 and 6 ended at the same sets on four
#: measured motions of an array.
WIDTH = 2
#: Sizes of a component where many thousand numbers show a thousandth of what data sheets give.
FINE_SIZES = 2.0 ** np.arange(-10.0, 5.0)
#: The same in a fold, which the components of the whole search limit already.
FOLD_BEAMS, FOLD_DEEPEST = (4, 2), 3
#: Sd of a setting as its largest effect on a reading over the readings' noise; the half-Cauchy
#: prior of the sd is the bench's own (`NoisePrior`).
SETTINGS = (0.0, 1.0, 2.5, 6.0, 15.0, 40.0)
#: Prior probability that an axis is noisier than the others, and how many times it may be: data
#: sheets give z up to twice the noise of x and y, wear and supplies more.
UNEVEN, AXES = 0.1, (1.5, 2.25, 3.4, 5.0, 8.0)
#: Prior probability that rows in an order of work share settings as their neighbours do: all rows
#: of one dial value together would hold any error of the dial.
AS_SET = 0.98
#: Prior probability that the bias walks, and sizes and memories (share of the rows) of the walk.
WALKS, WALK_SIZES, WALK_MEMORIES = 0.15, (0.5, 2.0), (0.2,)
#: The same of a recording, sizes over a run's scatter and memories over the span; simulated
#: (`benchmarks/closed_loop worn`: of 66 clean worlds none claims anything).
WANDERS, WALK_SIZE, WALK_MEMORY = 0.2, (0.3, 1.0, 3.0, 10.0), (0.5, 1 / 6, 1 / 24, 1 / 96)
#: Scatters beyond which a run counts less (Huber 1964).
UNLIKE = 2.5
