"""A thing with numbers in words: its kind, and every field that holds something, numbers with their
units.

What `print`, and a notebook at the end of a cell, show of an answer: its words and its numbers,
not the arrays it is made of. What is shown is read-only: it stays as it was built and checked.
"""

import dataclasses
import functools
import html
import inspect
import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import equinox as eqx
import jax
import numpy as np

from jaxclear.ground.module import AbstractModule
from jaxclear.ground.wording import described, public_name, unknown

if TYPE_CHECKING:
    from equinox._module._module import _ModuleMeta as PublicMeta
else:
    from jaxclear.ground.argument_errors import PublicMeta

INDENT = " " * 6
# Longest line [characters] that holds the parts of a thing, too.
LONGEST = 100
# What decides accuracy is typed of an integrator even where it is the default.
ALWAYS_TYPED = ("step", "rtol", "atol")
# Unit of a number by the metadata of its field.
Unit = Callable[[Mapping[str, Any]], str]


def unit_of_field(metadata: Mapping[str, Any]) -> str:
    """The unit that a field declares."""
    return metadata.get("unit", "1")


def specify_unit(part: Any, metadata: Mapping[str, Any]) -> Mapping[str, Any]:
    """The metadata of a field: of a stiffness by the exponent of its law, with that in the unit."""
    if not metadata.get("unit", "").endswith("^exponent"):
        return metadata
    power = 1.5 if part.exponent is None else part.exponent
    if isinstance(power, jax.core.Tracer) or np.ndim(power):
        return metadata
    return {**metadata, "unit": metadata["unit"].replace("exponent", f"{float(power):g}")}


def part_in_words(part: Any) -> str:
    """What a user types for its class, and its fields: in a line, or a line for each part in it."""
    kind = public_name(type(part))
    entries = list(fields_in_words(part))
    line = f"{kind} {', '.join(text for _, text in entries)}".rstrip()
    if len(line) <= LONGEST:
        return line
    inner = [text for name, text in entries if isinstance(getattr(part, name), eqx.Module)]
    plain = [text for name, text in entries if not isinstance(getattr(part, name), eqx.Module)]
    return "\n".join(
        [f"{kind} {', '.join(plain)}".rstrip(), *(f"{INDENT}{text}" for text in inner)]
    )


def as_typed(part: Any) -> str:
    """A part as a user would write it, defaults left out: FixedStep(step=5e-05, method="heun")."""
    arguments = []
    for field in dataclasses.fields(part):
        value, default = getattr(part, field.name), field.default
        if default is dataclasses.MISSING and field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        number = isinstance(value, (jax.Array, float)) and np.ndim(value) == 0
        if isinstance(value, eqx.Module):
            text = "" if type(value) is type(default) else f"{type(value).__name__}()"
        elif number and (field.name in ALWAYS_TYPED or default is None or value != default):
            text = f"{float(value):.9g}"
        elif number or value == default:
            text = ""
        else:
            text = f'"{value}"' if isinstance(value, str) else repr(value)
        arguments += [f"{field.name}={text}"] if text else []
    return f"{type(part).__name__}({', '.join(arguments)})"


def numbers_in_words(part: Any, unit: Unit = unit_of_field) -> str:
    """All fields of a part in a line."""
    return ", ".join(text for _, text in fields_in_words(part, unit))


def fields_in_words(part: Any, unit: Unit = unit_of_field) -> Iterator[tuple[str, str]]:
    """Every field that holds something, by name, in the order of its arguments: numbers with units,
    parts by their kind."""
    for field in sorted(dataclasses.fields(part), key=lambda f: bool(f.kw_only)):
        value = getattr(part, field.name)
        empty = isinstance(value, (str, tuple, dict)) and not value
        if value is not None and not empty:
            text = _format_value(value, specify_unit(part, field.metadata), unit)
            yield field.name, f"{field.name} {text}"


def _format_value(value: Any, metadata: Mapping[str, Any], unit: Unit) -> str:
    if isinstance(value, eqx.Module):
        return in_a_line(value, unit)
    unit_text = unit(metadata)
    unit_text = "" if unit_text in ("", "1") or unit_text.startswith("(") else f" {unit_text}"
    return f"{number_in_words(value)}{unit_text}"


@functools.singledispatch
def in_a_line(part: Any, unit: Unit = unit_of_field) -> str:
    """A part of a thing: its class, and its fields in brackets. What has words of its own registers
    them."""
    inner = numbers_in_words(part, unit)
    return f"{type(part).__name__}{f'({inner})' if inner else ''}"


def number_in_words(value: Any) -> str:
    """A number, several in brackets, a name; of anything large its kind."""
    if isinstance(value, jax.core.Tracer):
        return "(traced)"
    if isinstance(value, tuple):
        entries = ", ".join(map(_format_entry, value))
        return f"({entries})" if len(value) != 1 else entries
    if isinstance(value, (jax.Array, float)) and not getattr(value, "shape", ()):
        return f"{float(value):.6g}"
    return value if isinstance(value, str) else described(value)


def _format_entry(value: Any) -> str:
    return in_a_line(value) if isinstance(value, eqx.Module) else number_in_words(value)


# Numbers between these need no exponent; an error that is a smaller share is none to be seen.
SMALL, PLAIN, LEAST_ERROR_SHARE = 1e-3, 1e6, 1e-6
# Columns of a terminal; lines of a text from which on a notebook folds it.
WIDTH, MOST_LINES = 80, 12
# Of a float64; and of a number that a user gave, without the rounding of a sum.
MOST_DIGITS, USER_DIGITS = 15, 10


class AbstractShown(AbstractModule, metaclass=PublicMeta):
    """What is shown in words and tables."""

    @abstractmethod
    def _summary(self) -> Any:
        """A text, or texts and tables in their order. The first line of a long one says what it
        is of."""

    def __str__(self) -> str:
        return "\n".join(map(str, self._parts()))

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """What a console of IPython shows."""
        printer.text(str(self))

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            eqx.Module.__setattr__(self, name, value)
        except dataclasses.FrozenInstanceError:
            raise dataclasses.FrozenInstanceError(_read_only(type(self), name)) from None

    def __delattr__(self, name: str) -> NoReturn:
        raise dataclasses.FrozenInstanceError(_read_only(type(self), name))

    def __reduce__(self):
        # Copies and what is unpickled: Equinox takes what its own `__new__` makes outside of a call
        # of the class for something that is being built, and keeps it until the process ends.
        return object.__new__, (type(self),), vars(self)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return "".join(map(_format_html, self._parts()))

    def _parts(self) -> tuple[Any, ...]:
        content = self._summary()
        return (content,) if isinstance(content, str) else tuple(content)


def _read_only(kind: type, name: str) -> str:
    """Why a field cannot be set, and what to do in its place."""
    fields, owner = [field.name for field in dataclasses.fields(kind)], public_name(kind)
    if name not in fields:
        return unknown("field", name, fields, f" in {owner}")
    # A class with an `__init__` of its own may take other arguments than it has fields.
    plain = list(inspect.signature(kind).parameters) == fields
    hint = f", dataclasses.replace(it, {name}=...)" if plain else ""
    return (
        f"{owner} is read-only: {name} stays as it was built and checked. Build another{hint}; "
        "mechanism.with_body, with_joint, with_load and with_coupling put it in. To change a "
        "number alone write equinox.tree_at(lambda mechanism: ..., mechanism, number)."
    )


def with_text_repr(kind: Any) -> Any:
    """Decorates a class of few words (`__str__`): whatever shows it, a list that it is in too,
    shows these."""
    kind.__repr__ = kind.__str__
    kind._repr_html_ = lambda self: _format_html(str(self))
    return kind


def _format_html(part: Any) -> str:
    """A part of what is shown; the lines of a long text but the first fold out."""
    if not isinstance(part, str):
        return part._repr_html_()
    first, *others = html.escape(part).split("\n")
    if not others:
        return f"<p>{first}</p>"
    if len(others) < MOST_LINES:
        return f"<pre>{html.escape(part)}</pre>"
    folded = "\n".join(others)
    return f"<details><summary>{first}</summary><pre>{folded}</pre></details>"


def failed_samples_sentence(failed: int, sample: str) -> str:
    """A sentence for samples that failed; "" where none did."""
    several = f"{failed} {sample}s failed and are left out."
    return several if failed > 1 else f"1 {sample} failed and is left out." if failed else ""


def as_written(number: Any) -> str:
    """A number that a user gave, such as a limit, with all that anybody writes of it."""
    return f"{float(number):.{USER_DIGITS}g}"


def in_digits(value: float, error: float, least: int = 5) -> str:
    """A number as text, with two digits of its error.

    Args:
        value: to be printed.
        error: that bounds how many digits say something.
        least: smallest number of significant digits.
    """
    if not (math.isfinite(value) and math.isfinite(error) and value and error):
        return f"{value:.{least}g}"
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(abs(error))) + 2
    return f"{value:.{min(max(digits, least), MOST_DIGITS)}g}"


def in_few(value: float, digits: int) -> str:
    """A number with so many digits; no exponent for being large below a million, and no -0."""
    if math.isnan(value):
        return "–"
    text = f"{value or 0.0:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < PLAIN else text


def displayed_error(error: float) -> float:
    """An error as it is shown: one without a bound is not known."""
    return abs(error) if math.isfinite(error) else math.nan


def with_error(value: float, error: float) -> str:
    """A number beside its error, with so many digits that two of the error are among them; one
    exponent for both; – for an error that is not bounded."""
    if math.isinf(value):
        return in_few(value, 4)
    size = max(abs(value), error)
    if not (math.isfinite(size) and error > LEAST_ERROR_SHARE * size):
        has_bound = error > 0 and math.isfinite(size)
        digits = USER_DIGITS if has_bound else 4 if error else 6
        return f"{in_few(value, digits)} ± {in_few(displayed_error(error), 2)}"
    power = math.floor(math.log10(size))
    power = 0 if SMALL <= size < PLAIN else power
    places = power + 1 - math.floor(math.log10(error))
    texts = [f"{round(x / 10.0**power, places):.{max(places, 0)}f}" for x in (value, error)]
    if float(texts[0]) == 0:
        texts[0] = texts[0].lstrip("-")
    both = " ± ".join(texts)
    return f"({both})e{power:+03d}" if power else both
