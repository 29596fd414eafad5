"""Closing the loop: residual → missing effect → better model.

scores      what the calibrated particles say of a shift in the readings; scoring: from a state;
            information: what a blade's own parameters leave of it
case        a rotor to be diagnosed
families    what a model may lack: the built-in effects, by name
grammar     the cells of such families that readings can tell of
clock       the rotor's hours of a reading
signature   how a cell would move the readings
scan        every cell and pair against the residuals, with a null of their own
bayes       what cells by themselves, or some together, gain
misread     effects of one blade without any one of its readings, blades that one of them sets
            apart; coherent: beside what the simulation does wrong at all of them
chance      how often chance alone gains as much, over everything that was tried
hypotheses  cells and pairs with their evidence
verdict     adequate | effect | not separable | unattributed
adopt       an effect in the model, as a calibrated amplitude
diagnose    all of it in turn
search      what is calibrated, taken and given up again; choice: names first, then courses
conclude    the word, every name on its own turn; together: names that earn a place together alone
amplitudes  what readings say of effects in the model; halves: whether they hold between halves of
            blades and readings; concerned: whether all blades have the effect
alternatives  what else the readings allow: forecasts by other courses
transfer    whether an effect holds in another condition
noticed     where nothing was found: from which size on it would have been
report      before and after, on readings that neither model used
residuals   every reading predicted from the visits before it; omnibus: tests of what they should be
left_out    each reading as predicted without itself
pictures    what a report draws; densities: of amplitudes and parameters
separate    which inspections would tell rivals apart; rivals: for a set that is not separable
tell        as JSON
"""

from core.diagnosis.case import Case
from core.diagnosis.diagnose import Diagnosis, diagnose
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Facts
from core.diagnosis.report import BeforeAfter, before_after
from core.diagnosis.tell import to_json
from core.family import Family

__all__ = [
    "FAMILIES",
    "BeforeAfter",
    "Case",
    "Diagnosis",
    "Facts",
    "Family",
    "before_after",
    "diagnose",
    "to_json",
]
