"""The posterior over what a model lacks, to be read in this order.

odds        every number that decides, with its source
catalogue   what may be missing: names, scans, free functions, unnamed laws, and their priors
problem     the linear problem: readings less the base model's, and a column of each of these
noise       what the noise may be: points over which everything is summed
gram        products of the columns at every noise: all that is looked at from here on
space       the search over sets, and their posterior
words       what is concluded: the simplest set, its rivals, what is certain
solution    a set as a model: its parameters, and as a fit
explored    all of this at a fitted base model
slips       wrong records and slips of hand: other sheets in the same posterior
held_out    everything chosen anew without each fold
closed      the closed loop of a bench, and the one veto
recorded    the noise of a recording, whose bias walks
recording   the closed loop of a recording
"""
