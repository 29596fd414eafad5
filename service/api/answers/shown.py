"""What a diagnosis shows: pictures, inspections to come, rivals, what it would have found."""

from __future__ import annotations

from service.api.answers.words import ANY, NUMBER, TEXT, WHOLE, YES, each, having, maybe, named

TWICE = having(mean=NUMBER, sd=NUMBER, z=NUMBER)
BANDED = having(
    mean=each(each(NUMBER)),
    sd=each(each(NUMBER)),
    low=each(each(NUMBER)),
    median=each(each(NUMBER)),
    high=each(each(NUMBER)),
)
PLACED = having(mean=NUMBER, sd=NUMBER, spread=NUMBER, of=WHOLE, at_low=WHOLE, at_high=WHOLE)
PICTURES = having(
    schema=WHOLE,
    readings=each(
        having(
            id=TEXT,
            blade=TEXT,
            quantity=TEXT,
            unit=TEXT,
            time_h=NUMBER,
            rotor_h=NUMBER,
            instrument=maybe(TEXT),
            campaign=maybe(TEXT),
            value=NUMBER,
            before=TWICE,
            after=TWICE,
        )
    ),
    readings_not_shown=WHOLE,
    courses=maybe(
        having(
            ("now_h",),  # older reports have none
            quantity=TEXT,
            unit=TEXT,
            time_h=each(NUMBER),
            blades=each(TEXT),
            now_h=each(NUMBER),
            before=BANDED,
            after=BANDED,
        )
    ),
    amplitudes=each(
        having(
            name=TEXT,
            unit=TEXT,
            prior=having(low=NUMBER, high=NUMBER, mean=NUMBER, sd=NUMBER),
            quantiles=each(NUMBER),
            at_bound=maybe(TEXT),
            x=each(NUMBER),
            prior_density=each(NUMBER),
            density=each(NUMBER),
        )
    ),
    parameters=each(
        having(
            name=TEXT,
            level={"enum": ["shared", "local"]},
            unit=TEXT,
            low=NUMBER,
            high=NUMBER,
            effect=YES,
            before=maybe(PLACED),
            after=maybe(PLACED),
        )
    ),
)
READABLE = {
    "blade": TEXT,
    "quantity": TEXT,
    "time_h": NUMBER,
    "ahead_h": NUMBER,
    "instrument": maybe(TEXT),
    "sigma": maybe(NUMBER),
}
PLANNED = having(**READABLE, sd_after=NUMBER, narrower=NUMBER)
TELLS = {"gain_nat": NUMBER, "share": NUMBER, "settled": NUMBER}
CANDIDATE = READABLE | TELLS
SEPARATING = having(
    ("campaigns",),  # older reports have none
    rivals=each(having(("called",), names=each(TEXT), called=each(TEXT), weight=NUMBER)),
    entropy_nat=NUMBER,
    single=each(
        having(
            **CANDIDATE,
            unit=TEXT,
            blades_alike=WHOLE,
            expected=each(having(mean=NUMBER, sd=NUMBER)),
        )
    ),
    set=each(having(**CANDIDATE)),
    campaigns=each(
        having(
            quantity=TEXT,
            ahead_h=NUMBER,
            blades=WHOLE,
            instrument=maybe(TEXT),
            sigma=maybe(NUMBER),
            nodes=maybe(WHOLE),
            **TELLS,
        )
    ),
)
ADDS = having(
    ("parameters", "drifts", "biases", "quantities"),
    parameters=each(ANY),
    drifts=each(ANY),
    biases=each(ANY),
    quantities=named(ANY),
)
COURSE = having(name=TEXT, shape=TEXT, step_h=maybe(NUMBER))
FORESEEN = {"mean": NUMBER, "sd": NUMBER}
ALTERNATIVES = having(
    quantity=TEXT,
    time_h=NUMBER,
    blades=each(TEXT),
    before=having(**FORESEEN),
    together=having(**FORESEEN),
    each=each(
        having(
            ("number", "adoption"),  # older ones have none
            effects=each(COURSE),
            share=NUMBER,
            **FORESEEN,
            number=WHOLE,
            adoption=having(model=TEXT, effects=each(ANY), adds=ADDS),
        )
    ),
)
NOTICED = having(
    probability=NUMBER,
    alarm=NUMBER,
    families=each(
        having(
            family=TEXT,
            whom=TEXT,
            kind=TEXT,
            on=TEXT,
            target=TEXT,
            how=TEXT,
            of=TEXT,
            unit=TEXT,
            least=maybe(NUMBER),
            easiest=TEXT,
            most=maybe(NUMBER),
            hardest=TEXT,
        )
    ),
)
