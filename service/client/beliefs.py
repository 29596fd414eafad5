"""What the twin believes: posterior, draws, predictions, fields, and what would narrow them."""

from __future__ import annotations

from collections.abc import Sequence

from service.client import answers
from service.client.asking import below, listed, of_prediction
from service.client.steps import Call, Json, Steps, ask, path, told


def posterior(
    rotor: str, blade: str | None = None, *, version: int | None = None, at: str | None = None
) -> Steps[answers.RotorPosterior]:
    """The shared parameters' posterior, or one blade's; of a version, or as of a moment."""
    return ask("GET", below(rotor, blade, "posterior"), params=told(version=version, at=at))


def prediction(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    probability: float = 0.95,
    instrument: str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[answers.Prediction]:
    """Bands of a quantity by source; with an instrument, of a reading by it.

    quantity   default: the model's first one

    ``answer["health"]["trusted"]`` is False where the state behind it says why it is not.
    """
    params = of_prediction(quantity, times, node, probability, instrument, version, at)
    return ask("GET", below(rotor, blade, "prediction"), params=params)


def life(
    rotor: str,
    blade: str,
    limit: float,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    component: str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[answers.Life]:
    """When a blade passes a limit [the quantity's unit]: hours by which it has, and how surely.

    ``answer["quantiles"]["0.05"]`` is the hour by which it has passed it with probability 0.05;
    None: not within the model's hours.

    quantity   default: the model's first one
    component  x, y or z of a vector; default: z, the radius
    """
    params = told(
        limit=limit,
        quantity=quantity,
        times=listed(times),
        node=node,
        component=component,
        version=version,
        at=at,
    )
    return ask("GET", below(rotor, blade, "life"), params=params)


def rotor_life(
    rotor: str,
    limit: float,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    ahead: Sequence[float] | None = None,
    node: int | str | None = None,
    component: str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[answers.RotorLife]:
    """Which blades pass a limit [the quantity's unit] by when, how surely, and whether any does.

    `times` are hours of each blade's own operation, `ahead` hours from now on, the same for blades
    of all ages, which is what an outage asks: each blade then has its `age_h`, and what tells it
    (`age_by`). By `time_h`: of each of ``answer["blades"]`` the chance `passed`; of the rotor the
    number `expected`, and the chance `any` that at least one has. Blades share parameters, so `any`
    is not what independent ones would have.

    quantity, component   as of `life`
    """
    params = told(
        limit=limit,
        quantity=quantity,
        times=listed(times),
        ahead=listed(ahead),
        node=node,
        component=component,
        version=version,
        at=at,
    )
    return ask("GET", path("rotors", rotor, "life"), params=params)


def series(
    rotor: str,
    quantity: str | None = None,
    *,
    blade: str | None = None,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    component: str | None = None,
    probability: float = 0.95,
    version: int | None = None,
    at: str | None = None,
) -> Call:
    """Predictions as flat rows (blade, time, value, lower, upper), of all blades that run.

    time   operating hours; lower and upper hold a reading with the probability
    """
    params = told(
        quantity=quantity,
        blade=blade,
        times=listed(times),
        node=node,
        component=component,
        probability=probability,
        version=version,
        at=at,
    )
    return Call("GET", path("rotors", rotor, "series"), params)


def draws(
    rotor: str,
    blade: str | None = None,
    *,
    count: int | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[Json]:
    """Equally weighted draws: of a blade's parameters, or jointly of all blades'."""
    params = told(count=count, version=version, at=at)
    return ask("GET", below(rotor, blade, "draws"), params=params)


def field(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    time_h: float | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[answers.Field]:
    """Mean and sd of a field at every node at one hour, without a reading's noise."""
    params = told(quantity=quantity, time_h=time_h, version=version, at=at)
    return ask("GET", below(rotor, blade, "field"), params=params)


def plan(
    rotor: str,
    *,
    blade: str | None = None,
    quantity: str | None = None,
    time_h: float | None = None,
    parameter: str | None = None,
    count: int = 3,
) -> Steps[answers.Plan]:
    """Inspections by how much they would narrow a blade's prediction, or a parameter.

    time_h   hour of the prediction [h]; None: the model's last
    """
    params = told(blade=blade, quantity=quantity, time_h=time_h, parameter=parameter, count=count)
    return ask("GET", path("rotors", rotor, "plan"), params=params)
