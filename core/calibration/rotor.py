"""The rotor weighs what its blades say.

    log p(s, D) = log p(s) + Σ_b log m_b(s)

The shared nodes are placed from a few blades to all. A descent on the rough messages of some blades
of each kind (`panel`) goes from the whole box to near the posterior; their exact messages tell what
the rough ones miss, which is smooth: a quadratic through the difference, times the number of blades
that each stands for, mends the rough messages of all, and a descent on those is nearly free. Where
the quadratic leaves too much (few readings of each blade, small noise), the descent goes on with
the exact messages of the few, and then with those of all. At the end the exact messages at the
nodes must give even weights, seen by a surface that looks beyond them
(`surface.foreseen`): nodes beside the posterior can have even weights, too. What was tried is
judged together (`tried`). Where messages are cheap (a closed form's) and that is not reached, the
nodes of further placements are pooled (`placement.pooled`). The few blades may lead astray: with as
many parameters of their own as readings each, they fit at no noise at all, in a corner of the box.
Where no placement is found from there, the descent is made with all blades from the whole box, by
as many scouts as there will be nodes. Everything is a function of the set of readings; the columns
are kept, so that a new reading costs one blade's columns as long as the nodes stay. Where a
posterior is nearly known from another (`start`), nodes are tried there first and weighed by near
messages (`columns`), for they are there to be compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from core.calibration.columns import How, KeptColumns
from core.calibration.lead import panel, quadratic, start_of
from core.calibration.message import BladeMessage
from core.calibration.space import SharedSpace
from core.calibration.start import Start
from core.calibration.tried import Tried, judged, of_all, pool
from core.calibration.weighed import Weighed, effective, node_count, said
from core.smc.particles import ess, normalised
from core.smc.placement import descend, improved, moments, pooled, sobol
from core.smc.proposal import Proposal, finely_rounded, rounded

Array = NDArray[np.float64]
MISLED = 1.0  # nat that the quadratic which mends rough messages may leave
CARRIES = 0.15  # share of effective nodes from which a surface through them tells where to go
MOMENTS = 8  # effective nodes, beside d², from which the moments of what was tried are one more way
CIRCLE = 4  # placements at most that are looked at together
IDLE = 4  # turns without a better placement after which no more are tried
CHEAP_TURNS = 3  # placements tried where messages are cheap, before all nodes met are pooled
WELL = 0.4  # share of effective nodes that is enough then
POOLED = 512  # nodes of a round of those
EXPECTED = 4  # placements tried from where the posterior is expected
COMPARED = 0.3  # share of effective nodes that is enough there: 0.13 nat of evidence by 128 nodes
ALONE = (
    0.135  # nat of evidence: by so many nodes as leave that a rival's alone is known well enough
)
MORE = (
    0.35  # share that is enough where more than four are shared, above the floor of what is served
)
PASSABLE = 0.1  # share from which no other place is looked for there: 0.27 nat by 128 nodes
LED, LED_MANY = 3, 8  # placements tried from where mended rough messages lead; with more than four
FEW_TURNS = 4  # of the search after that, where no placement there was enough
ASTRAY = 0.05  # share of effective nodes below which a placement is given up for another


def weigh(
    space: SharedSpace,
    messages: Mapping[str, BladeMessage],
    known: KeptColumns,
    seed: int,
    *,
    rounds: int = 12,
    start: Start | None = None,
    placed: Proposal | None = None,
    floors: Mapping[str, float] | None = None,
) -> Weighed:
    """Place and weight the shared nodes for these messages.

    start  where they are tried first; none, for what must depend on the messages alone. With one
           a posterior is wanted for a comparison (if it is not `served`), and less is done to find
           it where it is not there; nothing, where the start is `alone`
    placed  the placement that these very messages, seed and start had before: nothing is searched
    floors  of what some blades say (`bounded`)
    """
    least_said = floors or {}
    messages = known.gathered(messages)
    d, n = space.dim, max(node_count(space.dim, bool(space.heavy)), 64 * space.tails)
    scouts, enough = (16 if d <= 2 else 32, 0.4 if space.heavy else 0.5) if d <= 4 else (128, MORE)
    tabled = 2 * sum(m.tabled for m in messages.values()) > len(messages)
    fitting, cheap = min(0.3, 1.2 / d), all(m.cheap for m in messages.values())
    if cheap:
        enough = max(enough, WELL)
    if start is not None and not start.served:
        enough = min(enough, COMPARED, effective(ALONE, n) if start.alone else 1.0)
    base = sobol(n, d, seed)
    counts, everyone = panel(messages), dict.fromkeys(sorted(messages), 1.0)

    def seen(unit: Array, how: How, blades: Mapping[str, float]) -> Array:
        """Σ_b c_b log m_b at nodes, (n,); the blades' counts are c_b."""
        found = known.all({b: messages[b] for b in blades}, unit, how)
        out = np.zeros(len(unit))
        for blade, count in blades.items():
            out = out + count * said(blade, found[blade], least_said)
        return out

    def exactly(
        start: Proposal, blades: Iterable[str], scouting: Array = base[:scouts]
    ) -> Proposal:
        """Where a descent on the exact messages of some blades ends; on those of a table, roughly:
        they are as good to look with."""
        some = sorted(blades)
        exact, rough = (
            {b: 1.0 for b in some if messages[b].tabled == is_rough} for is_rough in (False, True)
        )
        return descend(
            lambda unit: (
                space.log_prior(unit) + seen(unit, "exact", exact) + seen(unit, "rough", rough)
            ),
            start,
            scouting,
            enough=fitting,
        )

    def nearby(start: Proposal) -> Proposal:
        """Where a descent on the rough messages of some blades ends, and a little around."""
        if cheap or tabled:
            return start
        alike = dict.fromkeys(counts, 1.0)
        found = descend(
            lambda unit: space.log_prior(unit) + seen(unit, "rough", alike),
            start,
            base[:scouts],
            enough=fitting,
        )
        return found.spread(2.0)

    def mended(start: Proposal, blades: Mapping[str, float]) -> Proposal | None:
        """Where a descent on all rough messages ends, mended by the exact ones of some blades."""
        unit, log_q = start.nodes(base[:scouts])
        how: How = "near" if blades is everyone else "exact"
        exact, rough = (seen(unit, how, blades) for how in (how, "rough"))
        likely = space.log_prior(unit) + seen(unit, how, dict.fromkeys(blades, 1.0))
        mend, left = quadratic(unit, exact - rough, likely - log_q)
        if left > MISLED:
            return None
        return descend(
            lambda unit: space.log_prior(unit) + seen(unit, "rough", everyone) + mend(unit),
            start,
            base[:scouts],
            enough=fitting,
            max_levels=6,
        )

    def carried(place: Proposal) -> float:
        """The share of its nodes that are effective, whatever a surface believes beyond them: a
        hard edge fits no surface, and is no sign of having been led astray."""
        unit, log_q = place.nodes(base[:n])
        return ess(space.log_prior(unit) + seen(unit, "near", everyone) - log_q) / n

    def settled(start: Proposal, turns: int, least: float = 0.0) -> tuple[float, Proposal]:
        """The best share of effective nodes on the way from `start`, and its proposal.

        What a surface believes of places beyond the nodes may be looked at a turn later: all that
        was tried is judged together.
        """
        best, idle, tried = (-1.0, -1.0, start), 0, dict[bytes, Tried]()
        told = dict[bytes, float]()
        for _ in range(turns):
            unit, log_q = start.nodes(base[:n])
            log_p = space.log_prior(unit) + seen(unit, "near", everyone)
            here = tried[start.key] = Tried(start, unit, log_p, log_q)
            circle, ways, believed = list(tried.values())[-CIRCLE:], list[Proposal](), -1.0
            before = best
            leading = max(circle, key=lambda one: one.share)
            for one in (leading, here) if leading is not here else (here,):
                share, further = judged(one, circle)
                if further is None:  # no surface: what the last one said of it stands
                    share = min(share, told.get(one.proposal.key, share))
                told[one.proposal.key] = share
                ways += [further] if further is not None and one.share > CARRIES else []
                believed = max(believed, share)
                best = max(best, (share, one.share, one.proposal), key=lambda found: found[:2])
            if best[0] >= enough:
                break
            if len(circle) > 1 and here.share > CARRIES:
                ways += [further for _, further in [judged(here, [here])] if further is not None]
            better = best[0] > 1.05 * before[0] or best[1] > 1.05 * before[1]
            idle = 0 if better else idle + 1
            every, log_every, log_mixed = pool(circle)
            if ess(log_every - log_mixed) > d * d + MOMENTS:
                found = moments(every, normalised(log_every - log_mixed))
                ways.append(rounded(*found, space.heavy))
                ways.insert(0 if idle else len(ways), finely_rounded(*found, space.heavy))
            elif idle:  # too few of the last ones
                ways.insert(0, of_all([*tried.values()], d * d + MOMENTS))
            ways.append(improved(start, unit, log_p, log_q, fitting))
            fresh = [way for way in ways if way.key not in tried]
            if not fresh or believed < least or idle == IDLE:
                break
            start = fresh[0]
        return best[0], best[2]

    def led(place: Proposal) -> tuple[float, Proposal]:
        """The best share and its proposal where the mended rough messages lead, from `place`."""
        nearer = mended(place, counts)
        nearer = nearer and mended(nearer, everyone)
        return nowhere if nearer is None else settled(nearer, LED if d <= 4 else LED_MANY, ASTRAY)

    nowhere = (-1.0, Proposal(np.zeros(d), None))

    def found() -> tuple[float, Proposal]:
        """The best share of effective nodes, and its proposal, from nothing but the messages."""
        mends = len(counts) < len(messages) and not tabled
        place = nearby(start_of(space, messages))
        best = led(place) if mends else nowhere
        if best[0] < enough:
            place = exactly(place, counts)
            best = led(place) if mends and best is nowhere else best
        if best[0] < enough:
            turns = CHEAP_TURNS if cheap else rounds if start is None else FEW_TURNS
            best = max(best, settled(exactly(place, everyone), turns), key=lambda one: one[0])
        if best[0] < ASTRAY and start is None and carried(best[1]) < ASTRAY:
            place = exactly(start_of(space, messages), everyone, base[:n])
            best = max(best, settled(place, turns), key=lambda one: one[0])
        return best

    best, least = nowhere, enough if start is None else PASSABLE
    if placed is not None:
        best = (enough, placed)
    elif start is not None and (expected := start.on(space)) is not None:
        best, least = settled(expected, EXPECTED), 0.0 if start.alone else PASSABLE
    if best[0] < least:
        best = max(best, found(), key=lambda one: one[0])
    if best[0] < enough and cheap:
        place = pooled(
            lambda unit: space.log_prior(unit) + seen(unit, "exact", everyone),
            best[1],
            sobol(max(POOLED, n), d, seed),
            n,
            enough=WELL,
        )
        best = (enough, place)
    unit, log_q = best[1].nodes(base[:n])
    columns = known.all(messages, unit, "exact" if start is None else "near")
    return Weighed(unit, log_q, space.log_prior(unit), columns, best[1], least_said)
