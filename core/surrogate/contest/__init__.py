"""Which regressor: contests by cross-validation.

curve        the quick one, written into every model that is built: the tip's curve alone
kept         runs of an archive at some of their nodes, in memory
features     what all contestants learn: features of a joint SVD, and the way back to fields
chaos        sparse polynomial chaos
regressors   the seven contestants with their search spaces
boosters     those of them that need the extra `contest`
score        measures of predictions at runs that were left out
trial        one contestant on one fold: tuned within, fitted, measured
run          all of them, resumed
table        all trials together; who is first, by a rule that was there before
row          one value of the surrogate as a compiled polynomial

The rules of the long contest (`bladetwin study contest`). Every contestant predicts the same
features from the same inputs, on the same folds; bases and features are made anew in each fold
without the runs left out. The first is the one with the smallest geometric mean of three
cross-validated errors: tip elongation (95th percentile), CEEQ at the worst node (95th percentile)
and root-mean-square of the deformation field; targets as they are or transformed. Each has the
same number of configurations, and one of them is chosen by the same rule in an inner
cross-validation over the fold's training runs. Independent runs are looked at once, by the
configuration that the training runs chose.
"""

from core.surrogate.contest.curve import contest, contestants

__all__ = ["contest", "contestants"]
