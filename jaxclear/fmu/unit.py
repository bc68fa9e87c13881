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
from jaxclear.fmu.description import Variable, array, number, tables_of, text
from jaxclear.fmu.functions import (
    Flat,
    Functions,
    check_places,
    is_float,
    is_table,
    make_slopes,
    run_of_step,
)
from jaxclear.ground.arguments import check_name
from jaxclear.ground.wording import described, public_name
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.checks import Outcome
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import impact_speed_places, names
from jaxclear.multibody.topology import coordinate_units, numbers_of_parts
from jaxclear.native.standalone import Standalone, standalone
from jaxclear.native.writer import Unsupported
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
TWICE = (
    'the {what} of "{name}" stands twice in this FMU; time, inputs, parameters and outputs have '
    "different names, and a number is set by one of them."
)
NO_VALUE = 'output "{name}" returns {value}; it must return numbers.'
NO_EXCHANGE = "model exchange needs rates of the state alone, and {why}: take co-simulation."


def packed_size(leaves: Sequence[Any]) -> int:
    """Numbers of these that are packed: those of tables are not."""
    return sum(x.size for x in leaves if not is_table(x))


def place_of(leaf: Any, leaves: Sequence[Any]) -> int:
    """Which of the leaves one is."""
    return next(i for i, x in enumerate(leaves) if x is leaf)


def as_numbers(name: str, value: Any) -> Any:
    """An output's value as an array. Raises `ValueError` where it is no number."""
    try:
        return jnp.asarray(value, float)
    except (TypeError, ValueError):
        raise ValueError(NO_VALUE.format(name=name, value=described(value))) from None


def check_unique(what: str, rows: Sequence[tuple[Any, str]]) -> None:
    """Raises `ValueError` for the first row, a key and a name, whose key stood before."""
    for k, (key, name) in enumerate(rows):
        if key in [x for x, _ in rows[:k]]:
            raise ValueError(TWICE.format(what=what, name=name))


def c_numbers(leaves: Sequence[Any]) -> list[str]:
    """The packed numbers in C."""
    return [number(x) for leaf in leaves if not is_table(leaf) for x in np.ravel(leaf)]


def c_ending(run: Trajectory, code: Outcome) -> str:
    """Why a run ended so, in C, its time left to `printf`."""
    ended = dataclasses.replace(run, outcome=jnp.asarray(int(code)), ended=jnp.zeros(()))
    return text(message_of_the_end(ended).replace("%", "%%").replace("after 0 s", "after %g s"))


class Unit:
    """The functions and numbers of a unit; `made`: its code by name. `usual`: how long it runs, and
    a communication step [s]. Raises `ValueError` for what cannot be."""

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
        modelled = integrator.formulation.modelled(mechanism)
        if outputs is None:
            branches = [b.name for b in modelled.topology.branches if b.speed_count]
            outputs = {f"{n} {w}": (n, w) for n in branches for w in ("coordinate", "speed")}
        self.units: dict[str, str] = {}
        read = {name: self._make_output_reader(name, output) for name, output in outputs.items()}
        self.others: list[AbstractIntegrator] = []
        self.order = 0
        self.integrator = self._with_others(modelled, integrator) if slopes else integrator
        self.functions = Functions(mechanism, self.integrator, read, self.duration)
        zero, self.handed = jnp.zeros(()), self.functions.carry.leaves
        self.row = [self.handed[0], *self.handed, zero, zero]
        self.made: dict[str, Standalone] = {}
        self.states: list[str] = []
        self.contacts: list[str] = []

    def _make_output_reader(self, name: str, output: Any) -> Callable:
        """What reads an output of a run; its unit goes to `units`."""
        if callable(output):
            self.units[name] = unit_of(output, self.mechanism)
            return lambda run: as_numbers(name, output(run))
        if not (isinstance(output, tuple) and len(output) == 2):
            raise ValueError(NO_OUTPUT.format(name=name))
        joint, what = output
        check_name("quantity", what, QUANTITIES, f' of output "{name}"')
        units, per = set(coordinate_units(self.mechanism, joint)), QUANTITIES[what]
        self.units[name] = f"{units.pop()}{per}" if len(units) == 1 and per is not None else ""
        return lambda run: getattr(run, what)(joint)[-1]

    def _with_others(self, view: Mechanism, integrator: AbstractIntegrator) -> AbstractIntegrator:
        """The integrator in a form that those in other steps have, too, by which its slopes are
        judged. Raises `ValueError` where they are not those of the motion."""
        why = refusal(view, integrator)
        if why:
            raise ValueError(f"slopes of this FMU would not be those of the motion: {why}.")
        if not is_compared(view, integrator):
            return integrator
        step, times = integrator.requested_step(), np.array([0.0, self.interval])
        shares: Sequence[float] = (HALF,)
        if step is not None:
            self.order = order_of(view, integrator)
            many = np.ceil(self.interval / float(step) * (1 - SLIVER)) >= FEWEST
            shares = (LONGER if many else SHORTER)[self.order]
        self.others = [in_other_steps(integrator, jnp.asarray(x), times) for x in shares]
        return integrator if step is not None else integrator.with_max_step(jnp.asarray(jnp.inf))

    def add_numbers(self, inputs: Mapping[str, Any], parameters: Mapping[str, Any]) -> None:
        """The inputs and parameters. Raises `ValueError` for what cannot be one."""
        self.inputs = [self._number("input", name, of) for name, of in inputs.items()]
        self.parameters = [self._number("parameter", name, of) for name, of in parameters.items()]
        self.settable = [*self.inputs, *self.parameters]
        self.names = [one.name for one in self.settable]
        check_unique("name", [(name, name) for name in ("time", *self.names, *self.units)])
        check_unique("number", [(one.leaf, one.name) for one in self.settable])
        for name in self.slopes:
            check_name("slope", name, self.names, " among inputs and parameters of export_fmu")

    def _number(self, kind: str, name: str, where: Any) -> Variable:
        leaf, by_name = None if isinstance(where, str) else where(self.mechanism), where
        rows = numbers_of_parts(self.mechanism)
        matches = [row for row in rows if row[0] == by_name or row[1] is leaf]
        if len(matches) != 1 or np.ndim(matches[0][1]):
            raise ValueError(NO_NUMBER.format(kind=kind, name=name))
        path, leaf, metadata, unit = matches[0]
        original, run, run_at = self.functions.original.leaves, self.functions.run.leaves, 0
        if kind == "input":
            if not path.startswith("loads"):
                sentence = NO_RATE if ".drive" in path else NOT_OF_A_LOAD
                raise ValueError(sentence.format(name=name, number=path))
            run_at = packed_size(run[: place_of(leaf, run)])
        least, most = metadata.get("at_least", -np.inf), metadata.get("at_most", np.inf)
        least = np.nextafter(metadata["above"], np.inf) if "above" in metadata else least
        most = np.nextafter(metadata["below"], -np.inf) if "below" in metadata else most
        at = place_of(leaf, original)
        place = packed_size(original[:at]), run_at, at
        return Variable(name, unit, float(leaf), *place, float(least), float(most))

    def _make(self, name: str, numbers: Any, function: Callable, constants: Any = None) -> None:
        constants = self.functions.run.leaves if constants is None else constants
        self.made[name] = standalone(f"jc_{name}", function, constants, numbers)

    def assemble(self, exchange: bool) -> str:
        """Makes the functions, for model exchange too or not; the header in C."""
        functions = self.functions
        run, original = functions.run.leaves, functions.original.leaves
        carry, times = functions.carry.tree(self.handed), jnp.array([-self.interval, 0.0])
        mechanism, integrator = functions.run.tree(run)
        step_run = run_of_step(mechanism, integrator, carry.state, carry, times)
        checks = check_places(step_run.history.model(), carry)
        try:
            self._make("read", self.row, functions.read)
            self._make("start", [jnp.zeros(())], functions.start, original)
            more = [self._add_steps()]
            if checks:
                self._make("check", self.row, functions.check)
            more += [self._add_exchange(step_run)] if exchange else []
        except Unsupported as reason:
            kind = public_name(type(integrator))
            sentence = f"this mechanism does not become machine code on {kind}: {reason}."
            raise ValueError(sentence) from None
        code = "".join(one.text for one in self.made.values())
        self.token = hashlib.sha256(code.encode()).hexdigest()[:32]
        self.outputs = self._output_variables()
        lines = [
            check.sentence.replace("{figure:.2g}", "%.2g").format(place=place, limit=check.limit)
            for check, place in checks
        ]
        marked = functions.carry.tree(list(range(len(self.handed))))
        sizes = {
            "GIVEN": packed_size(original),
            "RUN": packed_size(run),
            "STATE": self.handed[0].size,
            "HANDED": packed_size(self.handed),
            "OUTPUTS": len(self.outputs),
            "INPUTS": len(self.inputs),
            "SETTABLE": len(self.settable),
            "LARGEST": max(one.outputs for one in self.made.values()) + 1,
            "OUTCOME": packed_size(self.handed[: marked.outcome]),
            "ACCEPTED": packed_size(self.handed[: marked.steps[0]]),
            "INTERVAL": number(self.interval),
            "TOKEN": text(self.token),
            "DOUBT": text(functions.doubt.replace("%", "%%")),
            "SLOPES": len(self.slopes),
            "CHECKS": len(checks),
            "STATES": len(self.states),
            "CONTACTS": len(self.contacts),
        }
        beyond = [f"{x.name} = %g is out of its range [{x.unit}]." for x in self.settable]
        arrays = {
            "double given": c_numbers(original),
            "double run": c_numbers(run),
            "double handed": c_numbers(self.handed),
            "int given_at": [str(x.at) for x in self.settable],
            "int run_at": [str(x.run_at) for x in self.settable],
            "double least": [number(x.least) for x in self.settable],
            "double most": [number(x.most) for x in self.settable],
            "char *const range_text": [text(x) for x in beyond],
            "char *const ending": [c_ending(step_run, code) for code in Outcome],
            "double check_limit": [number(check.limit) for check, _ in checks],
            "char *const check_text": [text(x[0].upper() + x[1:]) for x in lines],
        }
        return "\n".join(
            [
                *(f"#define {key} {value}" for key, value in sizes.items()),
                *(f"function jc_{one};" for one in self.made),
                *tables_of(self.made),
                *(array(key, values) for key, values in arrays.items()),
                *more,
            ]
        )

    def _output_variables(self) -> list[Variable]:
        """The outputs, each number of an array by its index."""
        shapes = jax.eval_shape(self.functions.read, self.functions.run.leaves, self.row)
        return [
            Variable(name + (f"[{','.join(map(str, index))}]" if index else ""), unit)
            for (name, unit), like in zip(self.units.items(), shapes, strict=True)
            for index in np.ndindex(like.shape)
        ]

    def _add_steps(self) -> str:
        """Makes the step, and what else slopes take; what C is told of these."""
        functions, run, zero = self.functions, self.functions.run.leaves, jnp.zeros(())
        if not self.slopes:
            self._make("step", self.row, functions.step)
            return ""
        chosen = [self.settable[self.names.index(name)] for name in self.slopes]
        slopes = make_slopes(functions, [one.leaf for one in chosen])
        handed = [x for x in self.handed if is_float(x)]
        tangents = [*(run[i] for i in slopes.moving), handed[0], *handed]
        row = [*self.row, zero, *map(jnp.zeros_like, tangents)]
        self._make("step_slope", row, slopes.step)
        self._make("read_slope", row, slopes.read)
        self._make(
            "start_slope", [zero] * (1 + len(chosen)), slopes.start, functions.original.leaves
        )
        plain, mechanism = c_numbers(run), functions.run.tree(run)[0]
        others = [c_numbers(Flat.of((mechanism, other)).leaves) for other in self.others]
        changed = [k for k in range(len(plain)) if any(x[k] != plain[k] for x in others)]
        sizes = {
            "MOVING": packed_size([run[i] for i in slopes.moving]),
            "D_HANDED": packed_size(handed),
            "OTHERS": len(others),
            "CHANGED": len(changed),
            "ORDER": self.order,
            "TRUSTED": TRUSTED,
            "SMALLEST": max(SMALLEST["equal" if self.order else "by tolerance"]),
        }
        arrays = {
            "unsigned slope_of": [str(1 + self.names.index(name)) for name in self.slopes],
            "int changed_at": list(map(str, changed)),
            "double changed_to": [x[k] for x in others for k in changed],
        }
        lines = [f"#define {key} {value}" for key, value in sizes.items()]
        return "\n".join([*lines, *(array(key, values) for key, values in arrays.items())])

    def _add_exchange(self, trajectory: Trajectory) -> str:
        """Makes the rate of the state; what C is told of it. Raises `ValueError`."""
        layout, system = trajectory.history.layout(), trajectory.history.model().system
        why = {
            "the forces of this integrator are means over its steps": (
                trajectory.formulation.forces_are_means
            ),
            "a load or coupling has states of its own": layout.states or layout.plays,
            "a load is sampled": sampled_loads(system),
            "loops are closed anew after each step": trajectory.mechanism.projects,
        }
        for reason, holds in why.items():
            if holds:
                raise ValueError(NO_EXCHANGE.format(why=reason))
        self._make("rate", self.row, self.functions.rates)
        self._make("remember", self.row, self.functions.remember)
        fixed, every = impact_speed_places(layout), names(system, layout)
        places = [k for k in range(layout.size) if k not in fixed]
        self.states = [every[k] for k in places]
        self.contacts = [f"{name}.{k}" for name, laws in layout.memories for k in range(len(laws))]
        return array("int state_at", list(map(str, places)))
