"""One of what the readings allow, chosen by a person.

Where names share the evidence, a diagnosis claims none: the readings do not tell which it is.
Somebody may know it from elsewhere, by a borescope, say, or a workshop's report of the coatings,
long before readings would. Each alternative that a diagnosis foretells by (`alternatives`) was
calibrated from all its readings and tells what it would put into the rotor's network; so it can be
adopted like a claim, with who chose it and why in the log. A rotor never chooses by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

from core.errors import InputError
from service.adopted import Sheet
from service.errors import AdoptionError
from service.ports import JobRecord, Json


@dataclass(frozen=True, slots=True)
class Choice:
    """Which of a diagnosis' alternatives, by its number, and from where it is known."""

    alternative: int
    because: str

    @staticmethod
    def of(alternative: int | None, because: str | None) -> Choice | None:
        """None where nothing is chosen. InputError: a choice without a reason, or the reverse.

        >>> Choice.of(2, "borescope of outage 4"), Choice.of(None, None)
        (Choice(alternative=2, because='borescope of outage 4'), None)
        """
        if alternative is None and because is None:
            return None
        if because is None:
            remedy = "say from where it is known which alternative it is (the log keeps it)"
            raise InputError("because", because, "is missing", remedy)
        if alternative is None:
            remedy = "give the number of one of the diagnosis' alternatives, or neither of both"
            raise InputError("alternative", alternative, "is missing", remedy)
        return Choice(alternative, because)

    def to_json(self) -> Json:
        """As the entry of the log tells it."""
        return {"alternative": self.alternative, "because": self.because}


def chosen(job: JobRecord, result: Json, choice: Choice) -> Json:
    """The result as it would be if the alternative were what it claims.

    Raises InputError for a number that is none of its alternatives', AdoptionError where it has
    none that could be adopted.
    """
    each = (result.get("alternatives") or {}).get("each") or ()
    anew = f"ask anew: POST /v1/rotors/{job.rotor_id}/diagnoses"
    if not each:
        problem = f"its verdict is {result['verdict']!r}, and it has no alternatives to choose from"
        remedy = f"adopt what it claims, or, where it was not asked to compare, {anew}"
        raise AdoptionError(job.id, "adopted", problem, remedy)
    if not 0 < choice.alternative <= len(each):
        there = f"GET /v1/rotors/{job.rotor_id}/diagnoses/{job.id} lists them"
        problem = f"is none of its {len(each)} alternatives"
        raise InputError("alternative", choice.alternative, problem, there)
    adoption = each[choice.alternative - 1].get("adoption")
    if not adoption:
        problem = "it is of a release that did not say what its alternatives add to the network"
        raise AdoptionError(job.id, "adopted", problem, anew)
    models = result["models"] | {"after": adoption["model"]}
    own = {"verdict": "effect", "effects": adoption["effects"], "adds": adoption["adds"]}
    return result | own | {"models": models}


def same(job: JobRecord, sheet: Sheet, choice: Choice | None) -> None:
    """AdoptionError: of this diagnosis something else is in the model than what is asked for."""
    there = sheet.chosen["alternative"] if sheet.chosen else None
    asked = choice.alternative if choice else None
    if there != asked:
        what = "what it claims" if there is None else f"its alternative {there}"
        problem = f"{what} is in the model, by entry {sheet.seq}"
        back = f"DELETE /v1/rotors/{job.rotor_id}/diagnoses/{job.id}/adoption backs it out first"
        raise AdoptionError(job.id, "adopted", problem, back)
