"""What a unit says of itself: the description that FMI reads, and the C header of its numbers."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from jaxclear.ground.datasets import installed


class Variable(NamedTuple):
    """A number of a unit by its `name`: its `unit`, the place `at` among the given numbers and of
    an input at `run_at` among those of the steps, its `value` and its range (least, most)."""

    name: str
    unit: str
    value: float = 0.0
    at: int = 0
    run_at: int = 0
    least: float = -np.inf
    most: float = np.inf


class Contents(NamedTuple):
    """What is in a unit, in the order of its variables."""

    name: str
    token: str
    inputs: list[Variable]
    parameters: list[Variable]
    outputs: list[Variable]
    states: list[str]
    contacts: list[str]
    kinds: tuple[str, ...]
    slopes: tuple[str, ...]
    duration: float
    interval: float


IDENTIFIER = "jaxclear_unit"


def description(unit: Contents) -> str:
    """modelDescription.xml."""
    count = iter(range(1, 1 << 30))
    lines = [_variable(0, "time", "s", causality="independent", variability="continuous")]
    for one in unit.inputs:
        about = {"causality": "input", "variability": "continuous", "start": repr(one.value)}
        lines.append(_variable(next(count), one.name, one.unit, **about))
    for one in unit.parameters:
        bounds = {"min": one.least, "max": one.most}
        about = {"causality": "parameter", "variability": "fixed", "initial": "exact"}
        about |= {k: repr(float(x)) for k, x in bounds.items() if np.isfinite(x)}
        lines.append(_variable(next(count), one.name, one.unit, **about, start=repr(one.value)))
    calculated = {"variability": "continuous", "initial": "calculated"}
    structure, unknown = [], []
    for one in unit.outputs:
        place = next(count)
        lines.append(_variable(place, one.name, one.unit, causality="output", **calculated))
        structure.append(f'<Output valueReference="{place}"/>')
        unknown.append(f'<InitialUnknown valueReference="{place}"/>')
    first = next(count)
    for k, name in enumerate([*unit.states, *(f"der({name})" for name in unit.states)]):
        rate = k >= len(unit.states)
        more = {"derivative": str(first + k - len(unit.states))} if rate else {}
        lines.append(_variable(first + k, name, "", causality="local", **calculated, **more))
        if rate:
            structure.append(f'<ContinuousStateDerivative valueReference="{first + k}"/>')
        unknown.append(f'<InitialUnknown valueReference="{first + k}"/>')
    for k, name in enumerate(unit.contacts, first + 2 * len(unit.states)):
        lines.append(_variable(k, f"depth of {name}", "m", causality="local", **calculated))
        unknown.append(f'<EventIndicator valueReference="{k}"/>')
    slopes = str(bool(unit.slopes)).lower()
    saved = 'canGetAndSetFMUState="true" canSerializeFMUState="true"'
    parts = {
        "model exchange": f'<ModelExchange modelIdentifier="{IDENTIFIER}" {saved} '
        'needsCompletedIntegratorStep="false"/>',
        "co-simulation": f'<CoSimulation modelIdentifier="{IDENTIFIER}" {saved} '
        f'canHandleVariableCommunicationStepSize="true" providesDirectionalDerivatives="{slopes}" '
        'canReturnEarlyAfterIntermediateUpdate="false"/>',
    }
    named = [*unit.inputs, *unit.parameters, *unit.outputs, Variable("", "m"), Variable("", "s")]
    units = sorted({one.unit for one in named} - {""})
    every = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(unit.name)} '
        f'instantiationToken="{unit.token}" generationTool="jaxclear {installed("jaxclear")}">',
        *(parts[kind] for kind in parts if kind in unit.kinds),
        f"<UnitDefinitions>{''.join(f'<Unit name={quoteattr(u)}/>' for u in units)}"
        "</UnitDefinitions>",
        '<LogCategories><Category name="logStatusWarning"/><Category name="logStatusError"/>'
        "</LogCategories>",
        f'<DefaultExperiment startTime="0" stopTime="{unit.duration!r}" '
        f'stepSize="{unit.interval!r}"/>',
        "<ModelVariables>",
        *lines,
        "</ModelVariables>",
        f"<ModelStructure>{''.join([*structure, *unknown])}</ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join(every)


def _variable(place: int, name: str, unit: str, **about: str) -> str:
    about |= {"unit": unit} if unit else {}
    words = " ".join(f"{key}={quoteattr(value)}" for key, value in about.items())
    return f'<Float64 name={quoteattr(name)} valueReference="{place}" {words}/>'


def number(value: Any) -> str:
    """A number in C."""
    value = float(value)
    return (
        repr(value)
        if np.isfinite(value)
        else {"inf": "INFINITY", "-inf": "-INFINITY"}.get(repr(value), "NAN")
    )


def text(sentence: str) -> str:
    """A text in C, in which `printf` may put one number."""
    return json.dumps(sentence, ensure_ascii=False)


def array(name: str, entries: Sequence[str]) -> str:
    """An array in C, by kind and name; of none one entry, which nobody reads."""
    return f"static const {name}[] = {{{', '.join(entries) or '0'}}};"


def tables_of(functions: Sequence[tuple[str, Sequence[np.ndarray]]]) -> list[str]:
    """Long arrays of functions by name, each once."""
    lines: list[str] = []
    known: dict[bytes, str] = {}
    for name, tables in functions:
        places = []
        for table in tables:
            key = np.ascontiguousarray(table).tobytes()
            if key not in known:
                known[key] = f"table_{len(known)}"
                lines.append(array(f"double {known[key]}", [number(x) for x in np.ravel(table)]))
            places.append(known[key])
        lines.append(array(f"double *const {name}_tables", places))
    return lines
