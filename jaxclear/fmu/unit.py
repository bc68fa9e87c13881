"""A unit under construction: which numbers it has, its functions as code that stands by itself, and
the C header that tells `fmi3.c` of both.
"""

import dataclasses
import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.errors.estimates import HALF
from jaxclear.fmu.description import Contents, Variable, array, number, tables_of, text
from jaxclear.fmu.functions import (
    Flat,
    Functions,
    check_places,
    is_float,
    make_slopes,
    run_of_step,
)
from jaxclear.ground.arguments import check_name
from jaxclear.ground.wording import public_name
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.checks import Outcome
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import impact_speed_places, names
from jaxclear.multibody.topology import coordinate_units, own_numbers
from jaxclear.native.standalone import Standalone, standalone
from jaxclear.native.writer import LONGEST_IN_REGISTERS, Unsupported
from jaxclear.results.response import unit_of
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.derivatives import (
    FEWEST,
    LONGER,
    SHORTER,
    SMALLEST,
    TRUSTED,
    in_other_steps,
    is_compared,
    order_of,
    refusal,
)
from jaxclear.simulation.not_finite import message_of_the_end
from jaxclear.simulation.sampling import sampled_loads

KINDS = ("co-simulation", "model exchange")
QUANTITIES = {"coordinate": "", "speed": "/s", "transmitted": None}
NO_RATE = (
    'input "{name}" is {number}, which moves parts: an input of FMI 3 has no rate, so a position '
    "cannot be one. Take a torque or force, or the target of a jaxclear.load.Servo."
)
NOT_OF_A_LOAD = (
    'input "{name}" is {number}; an input must be a number of a load, such as '
    'loads["motor"].value. What stays as it is during a run is one of the parameters.'
)
NO_NUMBER = (
    '{kind} "{name}" must be one number of the mechanism, by a function such as lambda rig: '
    'rig.connections["B"].joint.clearance, or by its name in mechanism.parameters().'
)
NO_OUTPUT = (
    'output "{name}" must be (joint, "coordinate"), (joint, "speed") or (joint, "transmitted"), a '
    "response, or a function of a run."
)
NOT_ASSEMBLED = (
    "With these parameters the mechanism cannot be assembled: its loops do not close, or parts "
    "start deep in each other."
)
NO_SLOPE = "this unit carries slopes of its outputs along {names} only."
NOT_TRUSTED = (
    "A slope at %g s is nan: in other steps it is another by more than a percent, so steps decide "
    "it. Take shorter ones."
)
NO_EXCHANGE = "model exchange needs rates of the state alone, and {why}: take co-simulation."


def offset(leaves: Sequence[Any], leaf: Any) -> int:
    """Where a leaf stands in a row of the packed numbers of all."""
    before = next(i for i, x in enumerate(leaves) if x is leaf)
    return packed_size(leaves[:before])


def packed_size(leaves: Sequence[Any]) -> int:
    """Numbers of these that are packed: those of tables are not."""
    return sum(x.size for x in leaves if not is_table(x))


def is_table(leaf: Any) -> bool:
    """Whether an array of the mechanism is read from memory."""
    return leaf.size > LONGEST_IN_REGISTERS and is_float(leaf)


def flat(leaves: Sequence[Any]) -> list[str]:
    """The packed numbers in C."""
    return [number(x) for leaf in leaves if not is_table(leaf) for x in np.ravel(leaf)]


def with_units(mechanism: Mechanism, outputs: Mapping[str, Any] | None) -> dict[str, tuple]:
    """By name a function of a run and the unit of what it gives. Raises `ValueError`."""
    if outputs is None:
        branches = [b.name for b in mechanism.topology.branches if b.speed_count]
        outputs = {f"{n} {what}": (n, what) for n in branches for what in ("coordinate", "speed")}
    found: dict[str, tuple[Callable, str]] = {}
    for name, output in outputs.items():
        if callable(output):
            found[name] = output, unit_of(output, mechanism)
            continue
        if not (isinstance(output, tuple) and len(output) == 2):
            raise ValueError(NO_OUTPUT.format(name=name))
        joint, what = output
        check_name("quantity", what, QUANTITIES, f' of output "{name}"')
        units, per = set(coordinate_units(mechanism, joint)), QUANTITIES[what]
        unit = f"{units.pop()}{per}" if len(units) == 1 and per is not None else ""
        found[name] = (lambda run, j=joint, w=what: getattr(run, w)(j)[-1]), unit
    return found


def ending(run: Trajectory, code: Outcome) -> str:
    """Why a run ended so, in C, its time left to `printf`."""
    ended = dataclasses.replace(run, outcome=jnp.asarray(int(code)), ended=jnp.zeros(()))
    return text(message_of_the_end(ended).replace("%", "%%").replace("after 0 s", "after %g s"))


class Unit:
    """The functions and numbers of a unit; `made`: its code by name, `notes` for its user."""

    def __init__(
        self,
        mechanism: Mechanism,
        integrator: AbstractIntegrator,
        outputs: Mapping[str, Any] | None,
        slopes: tuple[str, ...],
        usual: tuple[float, float],
    ):
        self.mechanism, self.slopes = mechanism, slopes
        self.duration, self.interval = map(float, usual)
        self.outputs = with_units(mechanism, outputs)
        self.others: list[AbstractIntegrator] = []
        self.order, self.equal_steps = 1, integrator.asked_step() is not None
        self.integrator = self._with_others(integrator) if slopes else integrator
        read = {name: function for name, (function, _) in self.outputs.items()}
        self.functions = Functions(mechanism, self.integrator, read, self.duration)
        own = self.functions
        zero, self.handed = jnp.zeros(()), own.carry.leaves
        self.row = [self.handed[0], *self.handed, zero, zero]
        self.made: dict[str, Standalone] = {}
        self.notes = [own.doubt] if own.doubt else []

    def _with_others(self, integrator: AbstractIntegrator) -> AbstractIntegrator:
        """The integrator in a form that those in other steps have, too, by which its slopes are
        judged. Raises `ValueError` where they are not those of the motion."""
        seen = integrator.formulation.seen(self.mechanism)
        why = refusal(seen, integrator)
        if why:
            raise ValueError(f"slopes of this FMU would not be those of the motion: {why}.")
        if not is_compared(seen, integrator):
            return integrator
        step, times = integrator.asked_step(), np.array([0.0, self.interval])
        self.order = order_of(seen, integrator)
        shares: Sequence[float] = (HALF,)
        if step is not None:
            many = np.ceil(self.interval / float(step) * (1 - SLIVER)) >= FEWEST
            shares = (LONGER if many else SHORTER)[self.order]
        self.others = [in_other_steps(integrator, jnp.asarray(x), times) for x in shares]
        return integrator if self.equal_steps else integrator.held(jnp.asarray(jnp.inf))

    def add_numbers(self, inputs: Mapping[str, Any], parameters: Mapping[str, Any]) -> None:
        """The inputs and parameters. Raises `ValueError` for what cannot be one."""
        self.inputs = [self._number("input", name, of) for name, of in inputs.items()]
        self.parameters = [self._number("parameter", name, of) for name, of in parameters.items()]
        self.settable = [*self.inputs, *self.parameters]
        self.names = [one.name for one in self.settable]
        for name in self.slopes:
            check_name("slope", name, self.names, " among inputs and parameters of export_fmu")

    def _number(self, kind: str, name: str, where: Any) -> Variable:
        leaf = where(self.mechanism) if callable(where) else None
        found = [
            row
            for row in own_numbers(self.mechanism)
            if (row[1] is leaf if callable(where) else row[0] == where)
        ]
        if len(found) != 1 or np.ndim(found[0][1]):
            raise ValueError(NO_NUMBER.format(kind=kind, name=name))
        path, leaf, metadata, unit = found[0]
        if kind == "input" and not path.startswith("loads"):
            sentence = NO_RATE if ".drive" in path else NOT_OF_A_LOAD
            raise ValueError(sentence.format(name=name, number=path))
        run_at = offset(self.functions.run.leaves, leaf) if kind == "input" else 0
        least, most = metadata.get("at_least", -np.inf), metadata.get("at_most", np.inf)
        if "above" in metadata:
            least = np.nextafter(metadata["above"], np.inf)
        if "below" in metadata:
            most = np.nextafter(metadata["below"], -np.inf)
        at = offset(self.functions.given.leaves, leaf)
        return Variable(name, unit, float(leaf), at, run_at, float(least), float(most))

    def _make(self, name: str, function: Callable, constants: Any, numbers: Any) -> None:
        self.made[name] = standalone(f"jc_{name}", function, constants, numbers)

    def assembled(self, name: str, kinds: tuple[str, ...]) -> tuple[Contents, str]:
        """What is in the unit, and its header in C. Raises `ValueError`."""
        own, run, given = self.functions, self.functions.run.leaves, self.functions.given.leaves
        carry = own.carry.tree(self.handed)
        mechanism, integrator = own.run.tree(run)
        times = jnp.array([-self.interval, 0.0])
        whole = run_of_step(mechanism, integrator, carry.state, carry, times)
        checks = check_places(whole.history.model(), carry)
        try:
            self._make("read", own.read, run, self.row)
            self._make("start", own.start, given, [jnp.zeros(())])
            lines = self._add_slopes()
            if checks:
                self._make("check", own.check, run, self.row)
            states, contacts, more = (
                self._add_exchange(whole) if KINDS[1] in kinds else ([], [], [])
            )
        except Unsupported as reason:
            kind = public_name(type(self.integrator))
            raise ValueError(
                f"this mechanism does not become machine code on {kind}: {reason}."
            ) from None
        usual = self.duration, self.interval
        code = "".join(one.text for one in self.made.values())
        token = hashlib.sha256(code.encode()).hexdigest()[:32]
        variables = self.inputs, self.parameters, self._outputs()
        unit = Contents(name, token, *variables, states, contacts, kinds, self.slopes, *usual)
        said = [
            check.sentence.replace("{figure:.2g}", "%.2g").format(place=place, limit=check.limit)
            for check, place in checks
        ]
        sizes = {
            "GIVEN": packed_size(given),
            "RUN": packed_size(run),
            "STATE": self.handed[0].size,
            "HANDED": packed_size(self.handed),
            "OUTPUTS": len(unit.outputs),
            "INPUTS": len(self.inputs),
            "SETTABLE": len(self.settable),
            "LARGEST": max(one.outputs for one in self.made.values()) + 1,
            "OUTCOME": self._place_of(lambda carry: carry.outcome),
            "ACCEPTED": self._place_of(lambda carry: carry.steps[0]),
            "INTERVAL": number(self.interval),
            "TOKEN": text(token),
            "DOUBT": text(own.doubt.replace("%", "%%")),
            "CO_SIMULATION": int(KINDS[0] in kinds),
            "MODEL_EXCHANGE": int(KINDS[1] in kinds),
            "SLOPES": len(self.slopes),
            "CHECKS": len(checks),
            "STATES": len(states),
            "CONTACTS": len(contacts),
            "ENDINGS": len(Outcome),
            "NOT_ASSEMBLED": text(NOT_ASSEMBLED),
            "NO_SLOPE": text(NO_SLOPE.format(names=" and ".join(self.slopes))),
            "NOT_TRUSTED": text(NOT_TRUSTED),
        }
        lines += [f"#define {key} {value}" for key, value in sizes.items()]
        lines += [
            f"void jc_{one}(const double *, double *, const double *const *);" for one in self.made
        ]
        lines += tables_of([(f"jc_{key}", one.tables) for key, one in self.made.items()])
        beyond = [f"{x.name} = %g is out of its range [{x.unit}]." for x in self.settable]
        arrays = {
            "double given": flat(given),
            "double run": flat(run),
            "double handed": flat(self.handed),
            "int given_at": [str(x.at) for x in self.settable],
            "int run_at": [str(x.run_at) for x in self.settable],
            "double least": [number(x.least) for x in self.settable],
            "double most": [number(x.most) for x in self.settable],
            "char *const range_text": [text(x) for x in beyond],
            "char *const ending": [ending(whole, code) for code in Outcome],
            "double check_limit": [number(check.limit) for check, _ in checks],
            "char *const check_text": [text(x[0].upper() + x[1:]) for x in said],
        }
        lines += [array(key, values) for key, values in arrays.items()]
        return unit, "\n".join([*lines, *more, ""])

    def _place_of(self, part: Callable) -> int:
        """Where a number stands among those that are handed on."""
        marked = self.functions.carry.tree(list(range(len(self.handed))))
        return packed_size(self.handed[: part(marked)])

    def _outputs(self) -> list[Variable]:
        """The outputs, each number of an array by its index."""
        own = self.functions
        shapes = jax.eval_shape(own.read, own.run.leaves, self.row)
        out = []
        for (name, (_, unit)), like in zip(self.outputs.items(), shapes, strict=True):
            for index in np.ndindex(like.shape):
                place = f"[{','.join(map(str, index))}]" if index else ""
                out.append(Variable(f"{name}{place}", unit))
        return out

    def _add_slopes(self) -> list[str]:
        """The step, with slopes where they are asked for, and what C is told of these."""
        own, run = self.functions, self.functions.run.leaves
        if not self.slopes:
            self._make("step", own.step, run, self.row)
            return [
                "#define STEP jc_step",
                "#define STEP_TABLES jc_step_tables",
                *(f"#define {name} 0" for name in ("MOVING", "D_HANDED", "OTHERS", "CHANGED")),
            ]
        along = [self._leaf_of(name) for name in self.slopes]
        slopes = make_slopes(own, along)
        zero = jnp.zeros(())
        handed = [x for x in self.handed if is_float(x)]
        tangents = [*(run[i] for i in slopes.moving), handed[0], *handed]
        row = [*self.row, zero, *map(jnp.zeros_like, tangents)]
        self._make("step_slope", slopes.step, run, row)
        self._make("read_slope", slopes.read, run, row)
        weights = [zero] * len(along)
        self._make("start_slope", slopes.start, own.given.leaves, [zero, *weights])
        plain = flat(run)
        others = [flat(Flat.of((own.run.tree(run)[0], other)).leaves) for other in self.others]
        changed = [k for k in range(len(plain)) if any(x[k] != plain[k] for x in others)]
        values = ["{" + ", ".join(x[k] for k in changed) + "}" for x in others]
        smallest = SMALLEST["equal" if self.equal_steps else "by tolerance"]
        sizes = {
            "STEP": "jc_step_slope",
            "STEP_TABLES": "jc_step_slope_tables",
            "MOVING": packed_size([run[i] for i in slopes.moving]),
            "D_HANDED": packed_size(handed),
            "OTHERS": len(others),
            "CHANGED": len(changed),
            "EQUAL_STEPS": int(self.equal_steps),
            "ORDER": self.order,
            "TRUSTED": TRUSTED,
            "SMALLEST": smallest,
        }
        known = [str(1 + self.names.index(name)) for name in self.slopes]
        return [
            *(f"#define {key} {value}" for key, value in sizes.items()),
            array("unsigned slope_of", known),
            array("int changed_at", list(map(str, changed))),
            f"static const double changed_to[][{max(1, len(changed))}] = "
            f"{{{', '.join(values) or '{0}'}}};",
        ]

    def _leaf_of(self, name: str) -> int:
        """Which of the given leaves a number that can be set is."""
        at = self.settable[self.names.index(name)].at
        given = self.functions.given.leaves
        places = [packed_size(given[:i]) for i in range(len(given))]
        return max(i for i, place in enumerate(places) if place == at)

    def _add_exchange(self, whole: Trajectory) -> tuple[list[str], list[str], list[str]]:
        """The rate of the state: names of states and contacts, and what C is told of them. Raises
        `ValueError`."""
        own, formulation, model = self.functions, whole.formulation, whole.history.model()
        layout = model.layout
        why = {
            "the forces of this integrator are means over its steps": formulation.forces_are_means,
            "a load or coupling has states of its own": layout.states or layout.plays,
            "a load is sampled": sampled_loads(model.system),
            "loops are closed anew after each step": whole.mechanism.projects,
        }
        for reason, holds in why.items():
            if holds:
                raise ValueError(NO_EXCHANGE.format(why=reason))
        self._make("rate", own.rates, own.run.leaves, self.row)
        self._make("remember", own.remember, own.run.leaves, self.row)
        fixed = set(impact_speed_places(layout))
        places = [k for k in range(layout.size) if k not in fixed]
        every = names(model.system, layout)
        contacts = [
            f"{name}.contact{k}" for name, kinds in layout.memories for k in range(len(kinds))
        ]
        return (
            [every[k] for k in places],
            contacts,
            [array("int state_at", list(map(str, places)))],
        )
