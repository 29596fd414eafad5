"""Fields as a few coefficients: randomised singular value decompositions.

dense     of a matrix in memory; the basis and what it does
streamed  of a matrix that is read a few rows at a time, any number of rows
runs      the runs of an archive as such rows, each quantity on a scale of its own
sweep     what a basis loses of runs that it has or has not seen, rank by rank
"""

from core.reduction.dense import Basis, randomized_svd

__all__ = ["Basis", "randomized_svd"]
