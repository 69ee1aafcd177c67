"""Every number that decides in the closed loop, each with its source.

"simulated" : set on simulated recordings that lack nothing, so that one or two of a hundred claim
something (`benchmarks/closed_loop`). No other file of this room holds a number that decides; what
stands elsewhere only guards against rounding, or is a length at which one way is quicker.
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
#: Eleven measured instruments have no say: log likelihoods 39.9, 39.8 and 39.4 at 2, 3.5 and 7
#: (`benchmarks/prior_odds.py`).
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
#: Sizes of what sessions share over those that the base model leaves them: a law of something that
#: sessions differ in leaves less, and is seen only where less is weighed.
BETWEEN = 5.0 ** -np.arange(3.0)
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

# How a search goes on: more costs time, less misses what leads only once it is solved.
#: Probability of the sets whose components are searched anew without a fold; of a value around
#: which a scan is refined; and components beside these sets in a fold.
SEEN, LIKELY, SINGLES = 1e-3, 0.05, 12
#: Noises on which many hypotheses are looked at first, and how many of these go on to all.
FEW, SHORT_LIST = 3, 60
#: Searches at most, each at the refit of the one before: two do, three on most measured motions.
SEARCHES = 5
#: Rounds until scatter, walk, weights and what is told stand still.
ROUNDS = 4
#: Models that an interval is mixed from at most.
WEIGHED = 12

# Free functions.
#: Terms of a response, one for so many rows, within bounds; terms of others.
ROWS_A_TERM, RESPONSE_TERMS, TERMS = 3, (8, 32), 6
#: Powers of its order by which a term is smaller than the first.
FALLS = (0, 1, 2)

# What is held out.
#: Folds of single positions, and groups up to which each is left out by itself, so that no shuffle
#: decides.
FOLDS, ALONE = 10, 12
#: Observations a group from which on groups are stretches of time, and the share of one on either
#: side that trains nothing.
STRETCH, GAP = 10, 0.03
#: Stretches of a long recording, every twelfth of which is predicted by the others: as far from
#: what was recorded as a reading that is corrected may be.
STRETCHES, EVERY = 120, 12

# Sheets that a hand wrote.
#: Nats from which on a sheet is read in another way, and a walk is told beside independent noise.
CLEAR = 5.0
#: Slips of one sheet, sheets that are refitted and that are searched again for each, hypotheses of
#: one class that are solved again, and rows up to which all are compared with all: a sheet with
#: more slips is better written anew, longer ones are recordings.
SLIPS_TOLD, REFITTED, TRIED, SOLVED_AGAIN, LONGEST = 5, 16, 2, 8, 250
#: A typed angle is wrong by at least so much (deg).
MISTYPED = 1.0
#: Steps to which dials are set, deg, and the share of a column that must be multiples of one.
DIAL_STEPS = (90.0, 45.0, 30.0, 22.5, 20.0, 15.0, 10.0, 5.0, 2.5, 2.0, 1.0, 0.5, 0.1, 0.01)
ON_STEP = 0.9
#: Rows up to which a block may end anywhere; beyond, it reaches to an end of the sheet.
ANY_BLOCK = 64
#: Width (mg) of the Cauchy density with which the reading that a shift leaves over repeats its
#: neighbour, or a stray one its prediction: a reading of another position costs 20 nats.
SPARE = 3.0
#: Significant figures of a cell of which two neighbours may have changed places.
FIGURES = 10
#: Rows that a part with other axes has at least (of a single one, its cells are asked), and, of
#: gravity, what the axes must move one reading by: an axis that stands level all the while reads a
#: few mg, and a drift does as much.
PART, MOVED = 2, 0.05
#: Misfit (mg rms) below which a linear map says nothing, misfit (mg) that any fixture may have of
#: bias, tilt and noise, and share of the plain misfit that another meaning must fall below.
BENCH, FIXTURE, FAR_BETTER = 2.0, 20.0, 1.0 / 3.0
#: Shuffles that rows in an order of work are held against.
SHUFFLES = 199
#: Cosine within which two directions are one face; chi-square of three numbers at p = 0.001; and
#: standard deviations of an angle that no hand sets, and of a size that is not gravity's.
SAME_FACE, WITHIN, FAR_ANGLE, FAR_SIZE = float(np.cos(np.deg2rad(5.0))), 16.3, 4.0, 5.0

# Converters.
#: Share of an end's height within which readings are at it; mg by which they fall short there, at
#: least, and times what the other rows, few or far from there, leave open of what they should be.
NEAR_END, SHORT, BEYOND = 0.01, 20.0, 8.0
#: Rows that must fall short or show the same extreme value, numbers of the others for each number
#: that is fitted to them, and by how much (mg) the other readings of these rows must differ.
REPEATS, NUMBERS, ELSEWHERE = 3, 2, 30.0
#: What data sheets let the squares, middles and angles of the ellipsoid be off by, twice the worst;
#: and the noise of a row's square over that of gravity.
ELLIPSOID, ROW_NOISE = np.array([0.06, 0.2, 0.04]), 2e-3
#: Share of a range by which its two ends may differ: a count of 16 bits.
COUNT = 5e-5
#: Steps (mg) that bury an ordinary noise, and the share of values that must lie on them.
WIDE_STEP, ON_STEPS = 3.0, 0.999
#: Scatter of the sensitivities of an accelerometer's axes, relative.
SENSITIVITY = 0.01

# What to record next.
#: Share of a block that the base model must leave for it to say anything, and sine of the angle
#: below which no number of observations tells two apart.
SHOWN, ALIKE = 1e-2, 3e-3
#: Probability with which a plan has to end an ambiguity, whichever rival is the truth; and its
#: observations: fewer would hang on one, which a wrong record explains as well.
ENDED, PLANNED = 0.9, (4, 24)
#: Sizes of a rival, in its typical size, over which its evidence is maximised; draws of it, and
#: the share of them that counts as few when plans are compared.
RIVAL_SIZES, DRAWS, UNLUCKY = (0.1, 0.3, 1.0, 3.0, 10.0), 24, 0.15

# What has changed: told once that it is likelier than not (`ACCUSED`), for a change that is missed
# costs as much as one that is none.
#: Shares of the noises of parts whose sizes are estimates, over which what changed is summed.
NOISES = 32
#: Chance with which a change of the size that is stated is told.
SEEN_IN = 0.8
