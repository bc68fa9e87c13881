"""Lubricant films, `jaxclear.film`: how hard a film in a journal bearing pushes back.

A film resists the squeeze velocity, which is the journal's as seen from axes that turn with the
mean of both spins; so squeeze and wedge are one. A new film is a subclass of `AbstractFilm`.
"""

from jaxclear.ground.argument_errors import imported_names, nothing_else
from jaxclear.laws.film.base import AbstractFilm as AbstractFilm
from jaxclear.laws.film.base import Vogel as Vogel
from jaxclear.laws.film.half import ShortHalfFilm as ShortHalfFilm
from jaxclear.laws.film.impedance import HalfFilm as HalfFilm
from jaxclear.laws.film.impedance import Reynolds as Reynolds

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.film", __all__)
