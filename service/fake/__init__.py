"""A small exact twin in memory: the science's seam for tests, trials and users' own tests.

conjugate   the twin: its network, its posterior and their formulas
outputs     what a blade does: bands, fields, the model's own answers
draws       draws of the posterior
questions   diagnoses, plans and residuals
beliefs     what a posterior tells, by these
twin        all of it behind the `Science` port
"""

from service.fake.conjugate import HORIZON_H, SCATTER, SD, SIGMA, FakeState
from service.fake.twin import FakeScience

__all__ = ["HORIZON_H", "SCATTER", "SD", "SIGMA", "FakeScience", "FakeState"]
