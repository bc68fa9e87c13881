"""From a trajectory to a number: what a study asks of a mechanism, with its unit and what of the
run it needs to be right. Any function of a trajectory is a response; `FromFunction` says its unit.

Those here are modules, so that a reference path or a threshold is a number that can change without
compiling again.
"""

import itertools
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.body import GROUND, Marker
from jaxclear.components.journal_film import film_of
from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.arguments import check_name
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import (
    AbstractQuantified,
    Scalar,
    count,
    lenient_converter,
    with_fields,
)
from jaxclear.ground.wording import described
from jaxclear.multibody.system import films_in, wearing_in
from jaxclear.multibody.topology import all_planar, coordinate_units, turns
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results import histories
from jaxclear.results.pointing_error import checked_through, checked_tip, tip_errors
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import Extremes, Trajectory

__all__ = [
    "AbstractResponse",
    "FilmFriction",
    "FinalCoordinate",
    "FromFunction",
    "LargestDeflection",
    "LargestError",
    "LostMotion",
    "MeanContactForce",
    "PeakContactForce",
    "PeakTransmitted",
    "PeakWornDepth",
    "PointingAngle",
    "PositionError",
    "ThinnestFilm",
    "WornVolume",
    "depends_on",
    "unit_of",
]

# What is off in a run where one part of it is: forces follow the motion, wear follows forces.
REACHES = {
    "motion": ("motion", "forces", "peak forces", "wear", "worn depth", "places in gaps"),
    "places": ("motion", "places in gaps"),
    "forces": ("forces", "peak forces", "wear", "worn depth"),
    "peak forces": ("peak forces",),
    "wear": ("wear", "worn depth"),
    "worn depth": ("worn depth",),
    "places in gaps": ("places in gaps", "wear", "worn depth"),
}


def _as_row(values: Any) -> Any:
    return None if values is None else jnp.asarray(values, float)


class AbstractResponse(AbstractQuantified):
    """A number computed from a run, with its unit.

    A subclass defines `__call__` and `unit`, and `drawn_from` where only a part of the run has to
    be accurate for it.

    Its field `unit` is the unit of the number, "" where `unit_in` derives it from the mechanism.
    """

    unit: eqx.AbstractVar[str]

    def unit_in(self, mechanism: Any) -> str:
        """The unit of the number for runs of a mechanism.

        Args:
            mechanism: the `Mechanism` whose runs are read.

        Returns:
            The unit as text, by default `unit`.
        """
        return self.unit

    def drawn_from(self) -> str:
        """The part of a run that has to be accurate for this response.

        A warning of a run about another part does not concern the response.

        Returns:
            One of "motion", "forces", "peak forces", "wear", "worn depth", "places in gaps" (at an
            instant), "anything" (the default).
        """
        return "anything"

    @abstractmethod
    def __call__(self, run: Trajectory) -> Scalar:
        """The response of a run.

        Args:
            run: a `Trajectory`.

        Returns:
            One number, an array of shape (), in `unit`.
        """


class AbstractSignal(AbstractQuantified):
    """Numbers computed from a run, one for each saving time, as a sensor records them."""

    @abstractmethod
    def __call__(self, run: Trajectory) -> Float[Array, " time"]:
        """The signal of a run.

        Args:
            run: a `Trajectory`.

        Returns:
            Values at the saving times, shape (time,), in the unit of the signal.
        """


def needs_of(response: Any) -> str:
    """The part of a run that has to be accurate for a response.

    Args:
        response: an `AbstractResponse` or a function of a run.

    Returns:
        As `AbstractResponse.drawn_from`; "anything" for a plain function.
    """
    return response.drawn_from() if isinstance(response, AbstractResponse) else "anything"


def depends_on(response: Any, concerns: str) -> bool:
    """Whether a warning about a part of a run concerns a response.

    Args:
        response: an `AbstractResponse` or a function of a run; every warning concerns a plain
            function.
        concerns: the part that the warning is about: "motion", "places", "forces", "peak forces",
            "wear", "worn depth" or "places in gaps".

    Returns:
        True where the response uses that part, or a part that follows from it (forces follow the
        motion, wear follows the forces).
    """
    needs = needs_of(response)
    return needs == "anything" or needs in REACHES.get(concerns, (needs,))


def unit_of(response: Any, mechanism: Any) -> str:
    """The unit of a response.

    Args:
        response: an `AbstractResponse` or a function of a run.
        mechanism: the `Mechanism` whose runs are read.

    Returns:
        The unit as text; "1" for a plain function.
    """
    return response.unit_in(mechanism) if isinstance(response, AbstractResponse) else "1"


__getattr__, __dir__ = nothing_else("jaxclear.response", __all__)

# What a response may need of a run.
DRAWN = {part for reached in REACHES.values() for part in reached}
# Forces that differ by no more than this share of themselves are the same but for rounding.
SAME_FORCE = 1e-9


class PeakWornDepth(AbstractResponse):
    """Largest depth of a wear map at the end of the run [m].

    Args:
        joint: name of a joint, or of a coupling whose flanks wear.
        surface: name of the surface, such as "bearing" (default) or "journal"; "upper" or "lower"
            for a flank of a coupling.
        unit: unit of the number, "m".
    """

    joint: str = eqx.field(static=True)
    surface: str = eqx.field(static=True, default="bearing")
    unit: str = eqx.field(static=True, default="m", kw_only=True)

    def drawn_from(self):
        return "worn depth"

    def __call__(self, run):
        depth = run.worn_depth(self.joint, self.surface)
        return wearing_in(run.mechanism)[self.joint].maps()[self.surface][0].deepest(depth)


class WornVolume(AbstractResponse):
    """Volume worn off a surface during the run [m^3].

    Args:
        joint: name of a joint, or of a coupling whose flanks wear.
        surface: name of the surface, such as "bearing" (default) or "journal"; "upper" or "lower"
            for a flank of a coupling.
        unit: unit of the number, "m^3".
    """

    joint: str = eqx.field(static=True)
    surface: str = eqx.field(static=True, default="bearing")
    unit: str = eqx.field(static=True, default="m^3", kw_only=True)

    def drawn_from(self):
        return "wear"

    def __call__(self, run):
        return run.worn_volume(self.joint, self.surface)[-1]


def _marker_of(body: Any) -> Marker:
    """A marker with its place; without one it stands for the centre of mass of a body."""
    own = checked_tip(body)
    return own if own is not body or own.at is not None else with_fields(own, at=(0.0, 0.0))


class PositionError(AbstractResponse):
    """Root mean square distance of a point of a body from a reference path [m].

    The mean is over the saving times.

    Args:
        body: a `Marker`, or the name of a body, whose centre of mass it then is.
        reference: positions of the reference path [m], shape (time, 3), ground frame, such as
            `run.marker(marker).position` or `run.body(name).com` of a run with the same duration
            and saving times.
        axes: numbers of the ground's axes along which the distance is measured, some of 0, 1, 2 (x,
            y, z); all by default.
        unit: unit of the number, "m".

    Raises:
        ValueError: if the reference has another shape, is not finite, or has another number of
            saving times than the run; if `axes` names other axes.
    """

    body: Marker = eqx.field(converter=_marker_of)
    reference: Float[Array, "time 3"] = eqx.field(
        converter=lenient_converter(lambda path: jnp.asarray(path, float))
    )
    axes: tuple[int, ...] = eqx.field(
        static=True,
        default=(0, 1, 2),
        metadata={"wanted": "a tuple of axes: 0 for x, 1 for y, 2 for z"},
    )
    unit: str = eqx.field(static=True, default="m", kw_only=True)

    def drawn_from(self):
        return "motion"

    def __check_init__(self):
        shape = getattr(self.reference, "shape", ())
        if len(shape) != 2 or shape[1] != 3:
            raise ValueError(
                f"response.PositionError has reference = {described(self.reference)}; it must be a "
                "path: an array (saving times, 3) [m], such as run.body(name).com."
            )
        is_concrete = not isinstance(self.reference, jax.core.Tracer)
        if is_concrete and not np.all(np.isfinite(self.reference)):
            raise ValueError(
                "response.PositionError has a reference that is not finite; every place [m] of the "
                "path must be."
            )
        if not self.axes or not set(self.axes) <= {0, 1, 2}:
            raise ValueError(
                f"response.PositionError has axes = {self.axes}; it must name some of 0, 1 and 2 "
                "(x, y and z)."
            )

    def __call__(self, run):
        name, whole = self.body.body, self.body.at is None
        path = run.body(name).com if whole else run.marker(self.body).position
        if path.shape != self.reference.shape:
            raise ValueError(
                f'the reference path of "{name}" has {len(self.reference)} saving times, the '
                f"run has {len(path)}: take it from a run over the same duration with "
                f"save={len(path)}."
            )
        away = (path - self.reference)[:, np.array(self.axes)]
        return safe_sqrt(jnp.mean(jnp.sum(away * away, axis=-1)))


class PointingAngle(AbstractResponse):
    """Angle between the boresight of a tip and that of the same chain with ideal joints [rad].

    The boresight is the z axis of the tip: of a link along x it is that of a
    `Marker(body, place, axis="x")`. The ideal chain has the joint coordinates of the run, so in a
    planar mechanism, whose journals do not tilt, there is no such angle.
    `jaxclear.pointing_error` shows which joints cause the angle.

    Args:
        tip: a `Marker`, or the name of a body, whose frame it then is.
        base: name of the body from which the tip is seen; "ground" by default.
        through: names of connections that the chain from base to tip passes, needed where there are
            several chains.
        peak: False (default): root mean square over the saving times; True: the largest value.
        unit: unit of the number, "rad".

    Raises:
        ValueError: if no clearance of a planar mechanism can turn the boresight.
    """

    tip: Marker = eqx.field(converter=checked_tip)
    base: str = eqx.field(static=True, default=GROUND)
    through: tuple[str, ...] = eqx.field(static=True, default=(), converter=checked_through)
    peak: bool = eqx.field(static=True, default=False)
    unit: str = eqx.field(static=True, default="rad", kw_only=True)

    def drawn_from(self):
        return "forces"

    def __call__(self, run):
        links, _, errors = tip_errors(run, self.tip, self.base, self.through)
        loose = [joint.name for joint in links.joints if not joint.ideal]
        _check_boresight(run.mechanism, self.tip, loose)
        angle = errors.pointing_angle
        return jnp.max(angle) if self.peak else safe_sqrt(jnp.mean(angle * angle))


def _check_boresight(mechanism: Any, tip: Marker, loose: list[str]) -> None:
    """Raises `ValueError` where none of the `loose` joints of a planar chain can turn the tip's
    boresight: the angle would be 0 whatever their clearances."""
    if not loose or not all_planar(mechanism.bodies):
        return
    turning = any(coordinate_unit(mechanism, name, 0) == "m" for name in loose)
    if not turning or tip.named_axis in ("z", "-z"):
        raise ValueError(
            f'response.PointingAngle of "{tip.body}" is 0 whatever the clearances: the mechanism '
            "is planar, where only a guide turns a boresight, and one in the plane. Read the tip's "
            "place by response.PositionError, an angle by response.LargestError or "
            "response.FromFunction, or describe the mechanism in space."
        )


class LargestDeflection(AbstractResponse):
    """Largest distance [m] of the axis of a `Beam` from a straight line, over the saving times and
    along the beam.

    Args:
        beam: name of the beam.
        relative_to: word for the line, as of `Trajectory.deflection`; "chord" by default.
        unit: unit of the response; "m" by default.
    """

    beam: str = eqx.field(static=True)
    relative_to: str = eqx.field(static=True, default="chord")
    unit: str = eqx.field(static=True, default="m", kw_only=True)

    def drawn_from(self):
        return "motion"

    def __call__(self, run):
        away = run.deflection(self.beam, self.relative_to)
        return safe_sqrt(jnp.max(jnp.sum(away * away, axis=-1)))


class LargestError(AbstractResponse):
    """Largest deviation of a coordinate, or of a body's centre of mass, from a reference [rad, m].

    It reads runs and positions alike.

    Args:
        joint: name of the joint whose coordinate is read; None (default) where a body is given.
        body: name of the body whose centre of mass is read; None (default) where a joint is given.
        axis: number of the ground's axis along which a body is read, 0 (default), 1 or 2.
        reference: values of the reference at the saving times or positions [rad, m], shape (time,);
            None (default): a `Scene` takes those of the mechanism without clearance and at nominal
            sizes.
        unit: unit of the number; by default ("") that of what is read.

    Raises:
        ValueError: if neither or both of joint and body are given, or there is no such axis.
    """

    joint: str | None = eqx.field(static=True, default=None)
    body: str | None = eqx.field(static=True, default=None, kw_only=True)
    axis: int = eqx.field(static=True, default=0, kw_only=True)
    reference: Float[Array, " time"] | None = eqx.field(
        default=None, kw_only=True, converter=lenient_converter(_as_row)
    )
    unit: str = eqx.field(static=True, default="", kw_only=True)

    def __check_init__(self):
        if (self.joint is None) == (self.body is None) or self.axis not in (0, 1, 2):
            raise ValueError(
                "response.LargestError reads the coordinate of a joint, or a body along one of the "
                "axes 0, 1, 2 (x, y, z); give it one of the two."
            )

    def unit_in(self, mechanism):
        if self.unit or self.joint is None:
            return self.unit or "m"
        return coordinate_unit(mechanism, self.joint, 0)

    def drawn_from(self):
        return "motion"

    def values(self, run: Any) -> Any:
        """What is read of a run.

        Args:
            run: a `Trajectory`, or positions.

        Returns:
            Values [rad, m], shape (time,).
        """
        if self.joint is not None:
            return run.coordinate(self.joint)
        return run.body(self.body).com[:, self.axis]

    def __call__(self, run):
        values = self.values(run)
        if self.reference is None or self.reference.shape != values.shape:
            raise ValueError(
                f"response.LargestError reads {len(values)} values and has a reference of "
                f"{0 if self.reference is None else len(self.reference)}; give it as many."
            )
        return jnp.max(jnp.abs(values - self.reference))


class LostMotion(AbstractResponse):
    """Largest difference of a joint's coordinate under the loads and under reversed loads [rad, m].

    It is the angle or distance that play allows while the drives stand still. It reads the
    positions of a `PositionProblem` with `reverse_loads=True`.

    Args:
        joint: name of the joint.
        unit: unit of the number; by default ("") that of the coordinate.
    """

    joint: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="", kw_only=True)

    def unit_in(self, mechanism):
        return self.unit or coordinate_unit(mechanism, self.joint, 0)

    def drawn_from(self):
        return "motion"

    def __call__(self, run):
        if isinstance(run, Trajectory):
            raise TypeError(
                f'response.LostMotion("{self.joint}") reads positions under loads and under '
                "reversed loads, not a run: give it jaxclear.positions(mechanism, ..., "
                "reverse_loads=True), or ask a jaxclear.PositionProblem. Of a run, compare "
                "run.coordinate(...) forwards and back."
            )
        back = run.reversed.coordinate(self.joint)
        return jnp.max(jnp.abs(run.coordinate(self.joint) - back))


class ThinnestFilm(AbstractResponse):
    """Least film thickness of a journal bearing at the saving times of a run [m]: the clearance
    less the eccentricity, below zero where the parts overlap.

    Args:
        joint: name of the joint, which has a film.
        unit: unit of the number, "m".
    """

    joint: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="m", kw_only=True)

    def drawn_from(self):
        return "places in gaps"

    def __call__(self, run):
        film = film_in(run, self.joint)
        offset = run.contact(self.joint).offset[:, :2]
        return film.clearance - safe_sqrt(jnp.max(jnp.sum(offset * offset, axis=-1)))


class FilmFriction(AbstractResponse):
    """Mean power that a film takes from the motion over all steps of a run [W], by shear and
    squeeze; where the motion is the ideal one (`NonColliding`) by its torque alone, at the saving
    times.

    Args:
        joint: name of the joint, which has a film.
        unit: unit of the number, "W".
    """

    joint: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="W", kw_only=True)

    def drawn_from(self):
        return "forces"

    def __call__(self, run):
        film_in(run, self.joint)
        return histories.film_loss(run.history, film_of(self.joint))


def film_in(run: Trajectory, name: str) -> Any:
    """The film of a joint. Raises `ValueError` for a joint that has none."""
    check_name("joint", name, run.mechanism.connections, " in this mechanism")
    film = films_in(run.mechanism).get(film_of(name))
    if film is None:
        raise ValueError(
            f'joint "{name}" has no film; give a PlanarJournalBearing one, '
            "film=jaxclear.film.Reynolds(viscosity=...)."
        )
    return film


class MeanContactForce(AbstractResponse):
    """Mean normal force of a joint with clearance over the run, summed over its contacts [N].

    It is the impulse (`Trajectory.contact_impulse`) divided by the duration, and does not depend on
    the choice of saving times.

    Args:
        joint: name of the joint.
        unit: unit of the number, "N".
    """

    joint: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="N", kw_only=True)

    def drawn_from(self):
        return "forces"

    def __call__(self, run):
        return run.contact_impulse(self.joint)[-1] / (run.time[-1] - run.time[0])


class PeakContactForce(AbstractResponse):
    """Largest normal force of a contact of a clearance joint, in all steps of the run [N].

    It is the largest of three: the forces at the saving times, the force at the end of any step
    (damping included) and the elastic force at the largest indentation. Only saving times count
    where forces are means over the saving intervals (rigid contact, joints that always touch);
    where the law follows a worn radius (`Wearing.worn_radius`) the elastic force at the largest
    indentation is left out. The derivative is that of the largest of the three.

    Args:
        joint: name of the joint.
        unit: unit of the number, "N".
    """

    joint: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="N", kw_only=True)

    def drawn_from(self):
        return "peak forces"

    def __call__(self, run):
        return peak_of_steps(run, self.joint, jnp.max(run.contact(self.joint).normal_force))


class PeakTransmitted(AbstractResponse):
    """Largest magnitude of the torque [N m] or force [N] that a coupling transmits.

    It is that of `Trajectory.transmitted` at the saving times and, where the force follows from the
    state (couplings with stiffness or play, `Cam`, `OneWay`, `Rope`, your own), in all steps
    between them. The derivative is that of the force at the step's end where it is largest; nan
    where steps are too long for it.

    Args:
        coupling: name of the coupling.
        unit: unit of the number; by default ("") "N m" for a coupling that turns, "N" for one that
            slides.
    """

    coupling: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="", kw_only=True)

    def unit_in(self, mechanism):
        coupling = mechanism.couplings.get(self.coupling)
        return self.unit or ("N m" if coupling is not None and turns(mechanism, coupling) else "N")

    def drawn_from(self):
        return "peak forces"

    def __call__(self, run):
        check_name("coupling", self.coupling, run.mechanism.couplings)
        saved = jnp.max(jnp.abs(run.transmitted(self.coupling)))
        return peak_of_steps(run, self.coupling, saved)


def peak_of_steps(run: Trajectory, name: str, saved: Scalar) -> Scalar:
    """The largest force of a joint or a flank in all steps of a run.

    Args:
        run: a `Trajectory`.
        name: name of a joint or of a coupling.
        saved: the largest force at the saving times [N, N m], shape ().

    Returns:
        The larger of `saved` and the peak of the steps [N, N m], shape ().
    """
    extremes, peak = run.extremes, _peak_over_steps(run, name)
    if extremes is not None and name in extremes.couplings:
        saved = jnp.maximum(saved, extremes.transmitted[extremes.couplings.index(name)])
    # A saving time is the end of a step too; as large, the peak beside it is the larger.
    return jnp.where(peak >= (1 - SAME_FORCE) * saved, peak, saved)


def _peak_over_steps(run: Trajectory, joint: str) -> Scalar:
    """Largest force [N] of any step, and elastic force at the deepest indentation; 0 where none was
    kept, and of contacts whose law changes with the radius as worn."""
    extremes = run.extremes
    if extremes is None or joint not in extremes.contacts or run.formulation.forces_are_means:
        return jnp.zeros(())
    return _largest_force(run.history, extremes, joint)


@compiled_quickly
def _largest_force(history: StateHistory, extremes: Extremes, joint: str) -> Scalar:
    """That of the steps' ends and of the deepest indentations. Compiled: outside of a study the
    preparation of the mechanism would cost more than the run."""
    system = history.model().system
    depths, *forces = (
        [each[k] for k, place in enumerate(extremes.contacts) if place == joint]
        for each in (extremes.indentation, extremes.force)
        if each is not None
    )
    laws = system.bearings[joint].contact_laws if joint in system.bearings else ()
    pairs = [pair for pair in zip(laws, depths, strict=False) if pair[0].unfitted is None]
    elastic = [own.contact.elastic_force(depth) for own, depth in pairs]
    return jnp.max(jnp.stack([jnp.zeros(()), *elastic, *itertools.chain(*forces)]))


class FinalCoordinate(AbstractResponse):
    """A coordinate of a connection or of a floating body at the end of the run [rad, m, 1].

    Args:
        connection: name of the connection, or of the floating body.
        index: number of the coordinate, 0 (default) or more.
        unit: unit of the number; by default ("") that of the coordinate.
    """

    connection: str = eqx.field(static=True)
    index: int = count(0, "number of the coordinate", at_least=0)
    unit: str = eqx.field(static=True, default="", kw_only=True)

    def unit_in(self, mechanism):
        return self.unit or coordinate_unit(mechanism, self.connection, self.index)

    def drawn_from(self):
        return "motion"

    def __call__(self, run):
        values = run.coordinate(self.connection)
        coordinates = values[:, None] if values.ndim == 1 else values
        if self.index >= coordinates.shape[1]:
            raise ValueError(
                f'"{self.connection}" has {coordinates.shape[1]} coordinates; the index of '
                f"response.FinalCoordinate, {self.index}, must be below that."
            )
        return coordinates[-1, self.index]


class FromFunction(AbstractResponse):
    """A function of a run as a response with a unit.

    A plain function is accepted wherever a response is; it has no unit, so that tables and figures
    show its number without one.

    Args:
        function: takes a `Trajectory` (or `Positions`) and returns one number.
        unit: unit of the number.
        needs: part of the run that has to be accurate for it, as `AbstractResponse.drawn_from`
            returns it; "anything" by default.

    Raises:
        ValueError: if `needs` is not such a part.
    """

    function: Callable[[Any], Any]
    unit: str = eqx.field(static=True)
    needs: str = eqx.field(static=True, default="anything")

    def __check_init__(self):
        check_name("part of a run", self.needs, ["anything", *sorted(DRAWN)], " to draw from")

    def drawn_from(self):
        return self.needs

    def __call__(self, run):
        return self.function(run)


def coordinate_unit(mechanism: Any, name: str, index: int) -> str:
    """Unit of a coordinate of a joint or floating body.

    Args:
        mechanism: the `Mechanism`.
        name: name of the connection, floating body or motor.
        index: number of the coordinate, from 0 on.

    Returns:
        The unit as text; "1" where there is no such coordinate, which a run refuses.
    """
    units = coordinate_units(mechanism, name)
    return units[index] if index < len(units) else "1"
