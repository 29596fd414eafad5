"""Where to run a simulation.

maximin      one-shot designs: Latin hypercubes whose points keep far apart
region       where accuracy matters: weighted points, as a posterior's draws
acquisition  further runs, where they take most of the variance that matters
"""

from core.design.acquisition import Process, choose, reductions
from core.design.maximin import criterion, maximin_lhs
from core.design.region import Region

__all__ = ["Process", "Region", "choose", "criterion", "maximin_lhs", "reductions"]
