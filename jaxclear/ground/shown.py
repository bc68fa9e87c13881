"""What `print`, and a notebook at the end of a cell, show of an answer: its words and its numbers,
not the arrays it is made of. What is shown is read-only: it stays as it was built and checked.
"""

import dataclasses
import html
import inspect
import math
from abc import abstractmethod
from typing import Any, NoReturn

import equinox as eqx

from jaxclear.ground.wording import public_name, unknown

# Numbers between these need no exponent; an error that is a smaller share is none to be seen.
SMALL, PLAIN, GIVEN = 1e-3, 1e6, 1e-6
# Columns of a terminal; lines of a text from which on a notebook folds it.
WIDTH, MOST_LINES = 80, 12
# Of a float64; and of a number that a user gave, without the rounding of a sum.
MOST_DIGITS, GIVEN_DIGITS = 15, 10


class AbstractShown(eqx.Module):
    """What is shown in words and tables."""

    @abstractmethod
    def _shown(self) -> Any:
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

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return "".join(map(_in_html, self._parts()))

    def _parts(self) -> tuple[Any, ...]:
        shown = self._shown()
        return (shown,) if isinstance(shown, str) else tuple(shown)


def _read_only(kind: type, name: str) -> str:
    """Why a field cannot be set, and what to do in its place."""
    fields, owner = [field.name for field in dataclasses.fields(kind)], public_name(kind)
    if name not in fields:
        return unknown("field", name, fields, f" in {owner}")
    # A class with an `__init__` of its own may take other arguments than it has fields.
    plain = list(inspect.signature(kind).parameters) == fields
    way = f", dataclasses.replace(it, {name}=...)" if plain else ""
    return (
        f"{owner} is read-only: {name} stays as it was built and checked. Build another{way}; "
        "mechanism.with_body, with_joint, with_load and with_coupling put it in. To change a "
        "number alone write equinox.tree_at(lambda mechanism: ..., mechanism, number)."
    )


def shown_in_words(kind: Any) -> Any:
    """Decorates a class of few words (`__str__`): whatever shows it, a list that it is in too,
    shows these."""
    kind.__repr__ = kind.__str__
    kind._repr_html_ = lambda self: _in_html(str(self))
    return kind


def _in_html(part: Any) -> str:
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


def left_out(failed: int, sample: str) -> str:
    """A sentence for samples that failed; "" where none did."""
    several = f"{failed} {sample}s failed and are left out."
    return several if failed > 1 else f"1 {sample} failed and is left out." if failed else ""


def as_written(number: Any) -> str:
    """A number that a user gave, such as a limit, with all that anybody writes of it."""
    return f"{float(number):.{GIVEN_DIGITS}g}"


def in_digits(value: float, error: float, least: int = 5) -> str:
    """A number with so many digits that two of its error are among them, and at least so many."""
    if not (math.isfinite(value) and math.isfinite(error) and value and error):
        return f"{value:.{least}g}"
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(abs(error))) + 2
    return f"{value:.{min(max(digits, least), MOST_DIGITS)}g}"


def in_few(value: float, digits: int) -> str:
    """A number with so many digits; no exponent for being large below a million, and no -0."""
    if math.isnan(value):
        return "–"
    told = f"{value or 0.0:.{digits}g}"
    return f"{float(told):.0f}" if "e+" in told and abs(value) < PLAIN else told


def error_told(error: float) -> float:
    """An error as it is shown: one without a bound is not known."""
    return abs(error) if math.isfinite(error) else math.nan


def with_error(value: float, error: float) -> str:
    """A number beside its error, with so many digits that two of the error are among them; one
    exponent for both; – for an error that is not bounded."""
    if math.isinf(value):
        return in_few(value, 4)
    size = max(abs(value), error)
    if not (math.isfinite(size) and error > GIVEN * size):
        known = error > 0 and math.isfinite(size)
        digits = GIVEN_DIGITS if known else 4 if error else 6
        return f"{in_few(value, digits)} ± {in_few(error_told(error), 2)}"
    power = math.floor(math.log10(size))
    power = 0 if SMALL <= size < PLAIN else power
    places = power + 1 - math.floor(math.log10(error))
    told = [f"{round(own / 10.0**power, places):.{max(places, 0)}f}" for own in (value, error)]
    if float(told[0]) == 0:
        told[0] = told[0].lstrip("-")
    both = " ± ".join(told)
    return f"({both})e{power:+03d}" if power else both
