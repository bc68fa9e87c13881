"""What a unit says of itself: the description that FMI reads (`modelDescription.xml`), and how
numbers, texts and arrays stand in its C header.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from jaxclear.ground.datasets import installed

IDENTIFIER = "jaxclear_unit"
SAVED = 'canGetAndSetFMUState="true" canSerializeFMUState="true"'
KINDS = {
    "model exchange": f'<ModelExchange modelIdentifier="{IDENTIFIER}" {SAVED} '
    'needsCompletedIntegratorStep="false"/>',
    "co-simulation": f'<CoSimulation modelIdentifier="{IDENTIFIER}" {SAVED} '
    'canHandleVariableCommunicationStepSize="true" providesDirectionalDerivatives="{slopes}"/>',
}
# Parts of a unit's structure, in their order.
STRUCTURE = ("Output", "ContinuousStateDerivative", "InitialUnknown", "EventIndicator")


class Variable(NamedTuple):
    """A number of a unit by its `name`: its `unit`, the place `at` among the original numbers, and
    of an input at `run_at` among those of the steps, which `leaf` it is, its `value` and range."""

    name: str
    unit: str
    value: float = 0.0
    at: int = 0
    run_at: int = 0
    leaf: int = 0
    least: float = -np.inf
    most: float = np.inf

    def about(self, causality: str, variability: str) -> dict[str, str]:
        """Its attributes as one that can be set."""
        bounds = {"min": self.least, "max": self.most, "start": self.value}
        about = {"causality": causality, "variability": variability}
        return about | {k: repr(float(x)) for k, x in bounds.items() if np.isfinite(x)}


def description(unit: Any, name: str, kinds: Sequence[str]) -> str:
    """Text of modelDescription.xml.

    Args:
        unit: with inputs, parameters, outputs and states.
        name: of the model.
        kinds: of FMI: "model exchange", "co-simulation".
    """
    calculated = {"variability": "continuous", "initial": "calculated"}
    inner, out = {"causality": "local"} | calculated, {"causality": "output"} | calculated
    time = {"causality": "independent", "variability": "continuous"}
    rows: list[tuple] = [("time", "s", time)]
    rows += [(x.name, x.unit, x.about("input", "continuous")) for x in unit.inputs]
    rows += [(x.name, x.unit, x.about("parameter", "fixed")) for x in unit.parameters]
    rows += [(x.name, x.unit, out, "Output", "InitialUnknown") for x in unit.outputs]
    first = len(rows)
    rows += [(x, "", inner, "InitialUnknown") for x in unit.states]
    for k, x in enumerate(unit.states, first):
        rate = inner | {"derivative": str(k)}
        rows.append((f"der({x})", "", rate, "ContinuousStateDerivative", "InitialUnknown"))
    rows += [(f"depth of {x}", "m", inner, "EventIndicator") for x in unit.contacts]
    lines = []
    for k, (label, measure, about, *_) in enumerate(rows):
        attributes = {"name": label, "valueReference": str(k), "unit": measure} | about
        words = (f"{key}={quoteattr(value)}" for key, value in attributes.items() if value)
        lines.append(f"<Float64 {' '.join(words)}/>")
    places = [
        f'<{part} valueReference="{k}"/>'
        for part in STRUCTURE
        for k, row in enumerate(rows)
        if part in row[3:]
    ]
    slopes = str(bool(unit.slopes)).lower()
    template = Path(__file__).parent / "modelDescription.xml"
    return template.read_text(encoding="utf-8").format(
        name=quoteattr(name),
        token=unit.token,
        version=installed("jaxclear"),
        kinds="".join(text.format(slopes=slopes) for kind, text in KINDS.items() if kind in kinds),
        units="".join(f"<Unit name={quoteattr(u)}/>" for u in sorted({r[1] for r in rows} - {""})),
        duration=unit.duration,
        interval=unit.interval,
        variables="\n".join(lines),
        structure="".join(places),
    )


def number(value: Any) -> str:
    """A number in C."""
    word = repr(float(value))
    return {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}.get(word, word)


def text(sentence: str) -> str:
    """A text in C, in which `printf` may put one number."""
    return json.dumps(sentence, ensure_ascii=False)


def array(name: str, entries: Sequence[str]) -> str:
    """An array in C, by kind and name; of none one entry, which nobody reads."""
    return f"static const {name}[] = {{{', '.join(entries) or '0'}}};"


def tables_of(functions: Mapping[str, Any]) -> list[str]:
    """Long arrays of functions by name, each once."""
    tables: dict[bytes, str] = {}
    place = lambda table: tables.setdefault(table.tobytes(), f"table_{len(tables)}")
    named = {name: list(map(place, one.tables)) for name, one in functions.items()}
    rows = [array(f"double {x}", list(map(number, np.frombuffer(k)))) for k, x in tables.items()]
    return rows + [array(f"double *const jc_{x}_tables", places) for x, places in named.items()]
