"""A run and its replicas: the numerical errors of its standard answers, and of any other.

An error that falls in proportion to the step is twice what half of it changes, one that falls
faster is less (Richardson). Where a first replica finds something beyond half of what the
integrator promises, a second one with quarter steps is asked, as two runs may agree by chance; and
where paths in gaps have parted, a replica of the finer run whose start is moved in the tenth digit:
if these two agree, steps were too long; if not, the path is no answer.

Sources: Richardson 1911, Phil. Trans. R. Soc. A 210, 307, doi:10.1098/rsta.1911.0009; Roache 1994,
J. Fluids Eng. 116, 405, doi:10.1115/1.2910291.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxclear.errors.accuracy import DRAWN, Asked, Seen, named
from jaxclear.errors.observables import Apart, parted
from jaxclear.errors.replicas import replica, thinned
from jaxclear.ground.quantity import is_traced
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.promise import PART_OF, Promise
from jaxclear.results.abstract_response import AbstractResponse
from jaxclear.results.trajectory import Trajectory
from jaxclear.results.verification import AbstractVerification, Estimate, Unverified, with_error

HALF, QUARTER = 0.5, 0.25
# Share of the promise from which on a second replica is asked.
DOUBT = 0.5
# Steps of a run up to which its replicas are run unasked: seconds in any mechanism.
MOST_STEPS = 100_000
# By how much of a radian or of a metre the start of a replica is moved.
TENTH_DIGIT = 1e-10
WORDS = {
    "places": "of the longest way",
    "gaps": "of the clearance",
    "mean_force": "of the largest",
    "peak_force": "of the largest",
    "losses": "of the largest",
    DRAWN: "of itself",
}


class Told(NamedTuple):
    """A standard answer with its told `error` in its unit, that `share`, and what is `promised` of
    it (None: nothing)."""

    apart: Apart
    error: float
    share: float
    promised: float | None

    @property
    def beyond(self) -> bool:
        """Whether the error is beyond what is promised."""
        return self.promised is not None and not self.share <= self.promised


class Lost(NamedTuple):
    """Paths that hang on the tenth digit of the start: from when [s], and within which time errors
    grow e-fold [s]."""

    since: float
    growth: float


class Verified(AbstractVerification):
    """A run with `replicas`, as responses see them, the coarser one first; `told`: its standard
    answers; `promise`: of its integrator; `lost`: where its path is no answer (None: it is one);
    `since` [s]: where the run began, from where on errors count; `why`: what its integrator was
    chosen for ("": it was given)."""

    replicas: tuple[Trajectory, ...]
    told: tuple[Told, ...] = eqx.field(static=True)
    promise: Promise = eqx.field(static=True)
    lost: Lost | None = eqx.field(static=True, default=None)
    since: float = eqx.field(static=True, default=0.0)
    why: str = eqx.field(static=True, default="")

    @property
    def beyond(self):
        return frozenset(told.apart.part for told in self.told if told.beyond)

    @property
    def warnings(self):
        beyond = sorted((t for t in self.told if t.beyond), key=lambda t: -t.share / t.promised)
        said = []
        if self.lost is not None:
            said.append(
                f"From {self.lost.since:.3g} s on places in gaps hang on the tenth digit of the "
                f"start (e-fold in {self.lost.growth:.2g} s): no run tells them; ask for means "
                "over samples."
            )
            beyond = [told for told in beyond if told.apart.part != "gaps"]
        if beyond:
            said.append(_sentence(beyond))
        return tuple(said)

    def estimate(self, run, response):
        value = response(run)
        values = [response(each) for each in self.replicas]
        error = told_error([abs(np.asarray(value) - np.asarray(each)) for each in values])
        return Estimate(value, error, self._how())

    def _how(self) -> str:
        steps = "half" if len(self.replicas) == 1 else "half and quarter"
        since = f", since {self.since:.6g} s" if self.since else ""
        return f"twice what {steps} steps change{since}"

    def promised(self, response: Any) -> float | None:
        """The share that is promised of a response; None for nothing."""
        needs = response.drawn_from() if isinstance(response, AbstractResponse) else "anything"
        return getattr(self.promise, PART_OF.get(needs, ""), None)

    def table(self):
        import pandas

        return pandas.DataFrame(
            [
                {
                    "answer": named(each.apart),
                    "value": each.apart.value,
                    "error": each.error,
                    "unit": each.apart.unit,
                    "share": each.share,
                    "promised": each.promised,
                }
                for each in self.told
            ]
        )

    def attributes(self):
        rows = [f"{named(t.apart)}: {t.error:.2g} {t.apart.unit}" for t in self.told]
        return {"numerical errors": "; ".join(rows)}

    def __str__(self) -> str:
        names = [named(told.apart) for told in self.told]
        width = max(map(len, names))
        lines = [f"{'answer':{width}}  {'value ± numerical error':28}{'share':>9}{'promised':>10}"]
        for name, (one, error, share, promised) in zip(names, self.told, strict=True):
            number = f"{with_error(one.value, error)} {one.unit}"
            own = "–" if promised is None else f"{100 * promised:.2g} %"
            mark = "  <- beyond" if promised is not None and not share <= promised else ""
            lines.append(f"{name:{width}}  {number:28}{100 * share:7.2g} %{own:>10}{mark}")
        return "\n".join([*lines, f"Numerical errors are {self._how()}. {self.why}".rstrip()])


def told_error(differences: list[Any]) -> Any:
    """The error that differences from the half, and the quarter, tell of steps of order 1."""
    errors = [d / (1 - share) for d, share in zip(differences, (HALF, QUARTER), strict=False)]
    return np.max(errors, axis=0)


def verified(
    run: Trajectory,
    integrator: AbstractIntegrator,
    again: Callable[..., Trajectory],
    verify: bool | None,
    asked: Asked | None = None,
) -> Trajectory:
    """The run with what its replicas tell; `again(replica, moved)`: the same run as that
    `Replica` is made, its start moved by so much. `verify`: whether replicas are run (None: where
    they take seconds at the most). `asked`: the accuracy (None: what the integrator promises)."""
    asked = Asked(integrator.promise) if asked is None else asked
    why = _why_not(run, verify)
    if why:
        why = f"{why}. {asked.why.removesuffix('.')}" if asked.why else why
        return dataclasses.replace(run, verification=Unverified(why))
    plans = [replica(integrator, run.time, share) for share in (HALF, QUARTER)]
    if plans[0] is None:
        return dataclasses.replace(run, verification=Unverified("its steps cannot be refined"))

    def repeated(plan: Any, moved: float = 0.0) -> Trajectory:
        return thinned(again(plan, moved), plan.every)

    own = asked.seen(run)
    replicas = [repeated(plans[0])]
    if not replicas[0].succeeded:
        return dataclasses.replace(run, verification=Failed(replicas[0].result))
    seen = [asked.seen(replicas[0])]
    told = _told(run, own, seen, asked)
    if any(t.promised is not None and not t.share <= DOUBT * t.promised for t in told):
        replicas.append(repeated(plans[1]))
        if not replicas[1].succeeded:
            return dataclasses.replace(run, verification=Failed(replicas[1].result))
        seen.append(asked.seen(replicas[1]))
        told = _told(run, own, seen, asked)
    lost = None
    limits = [t.promised for t in told if t.beyond and t.apart.part == "gaps"]
    if limits:
        lost = _lost(run, asked, seen[0], repeated(plans[0], TENTH_DIGIT), min(limits))
    known = tuple(dataclasses.replace(each, verification=Unverified()) for each in replicas)
    since = float(run.time[0])
    found = Verified(known, tuple(told), asked.promise, lost, since, asked.why)
    return dataclasses.replace(run, verification=found)


def _why_not(run: Trajectory, verify: bool | None) -> str:
    """Why a run has no replicas; "" where it is to have some."""
    if verify is False:
        return "verify=False"
    if is_traced((run.outcome, run.states)):
        return "a run that is traced has no replicas"
    if not run.succeeded:
        return "the run ended early"
    if verify is None and int(run.accepted_steps) > MOST_STEPS:
        return f"beyond {MOST_STEPS} steps replicas are run with verify=True"
    return ""


class Failed(AbstractVerification):
    """Of a run whose replica ended early; `result` says why."""

    result: str = eqx.field(static=True)

    def __str__(self) -> str:
        return self.warnings[0]

    @property
    def warnings(self):
        return (f"With shorter steps the same run fails, so its numbers may be off: {self.result}",)

    @property
    def beyond(self):
        return frozenset(Promise._fields)

    def estimate(self, run, response):
        return Estimate(response(run), math.nan, self.warnings[0])

    def table(self):
        return Unverified().table()

    def attributes(self):
        return {"verification": str(self)}


def _told(run: Trajectory, own: Seen, seen: list[Seen], asked: Asked) -> list[Told]:
    """The answers of a run beside what its replicas say."""
    rows = zip(*(asked.apart(run, own, other) for other in seen), strict=True)
    return [
        Told(
            row[0],
            float(told_error([each.off for each in row])),
            float(told_error([each.share for each in row])),
            asked.promised(row[0]),
        )
        for row in rows
    ]


def _lost(
    run: Trajectory, asked: Asked, finer: Seen, moved: Trajectory, limit: float
) -> Lost | None:
    """Where a path hangs on the tenth digit of its start, from how far a finer run and the same
    with its start moved are apart in gaps; None where they agree."""
    if not moved.succeeded:
        return None
    off = parted(finer.standard, asked.seen(moved).standard)
    beyond = off > limit
    if not beyond.any():
        return None
    first = int(np.argmax(beyond))
    elapsed = float(run.time[first] - run.time[0])
    began = max(float(off[0]), TENTH_DIGIT)
    return Lost(float(run.time[first]), elapsed / max(math.log(float(off[first]) / began), 1.0))


def _sentence(beyond: list[Told]) -> str:
    """What is off, by how much, and what to do, of the answers that are furthest beyond."""
    worst = beyond[0]
    more = f" (and {len(beyond) - 1} more answers)" if len(beyond) > 1 else ""
    told = f"{worst.share:.2g} {WORDS[worst.apart.part]} ({worst.promised:g} promised)"
    name = named(worst.apart)
    return f"{name[0].upper()}{name[1:]}: error about {told}{more}; take shorter steps."
