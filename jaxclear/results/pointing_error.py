"""Pointing error of a tip: exact, by the adjoint error model, and joint by joint.

The joints' deviations come from a run, so the error follows from the dynamics instead of from
assumed distributions. Twists of the tip are in the axes of the nominal tip, linear then angular;
the z axis of the tip is its boresight.

Error of a tip over the saving times of a run: a marker's pose against that of the same chain
with ideal joints.

The arithmetic of one instant is `multibody.product_of_exponentials`; here it is mapped over a run.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.body import GROUND, Marker
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, expect
from jaxclear.ground.datasets import Column, dataset
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.table import as_table
from jaxclear.ground.wording import described
from jaxclear.multibody.product_of_exponentials import (
    Chain,
    ChainConfiguration,
    TipError,
    chain,
    measured_configuration,
    tip_error,
    transform,
)
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.trajectory import Trajectory


def checked_tip(tip: Any) -> Marker:
    """A tip as a marker; a body's name stands for its frame."""
    if isinstance(tip, str):
        return Marker(tip)
    expect(tip, Marker, "the tip", "a jaxclear.Marker or the name of a body")
    return tip


def checked_through(through: Any) -> tuple[str, ...]:
    """Names of connections; a single name may stand alone."""
    if isinstance(through, str):
        return (through,)
    names = isinstance(through, (tuple, list)) and all(isinstance(name, str) for name in through)
    if not names:
        raise ValueError(
            f"through is {described(through)}; it must be names of connections, or one name."
        )
    return tuple(through)


@compiled_quickly
def configurations(trajectory: Trajectory, links: Chain) -> ChainConfiguration:
    """How the joints of a chain stand at every saving time."""
    histories = {name: trajectory.body(name) for name in links.bodies}

    def one(bodies):
        return measured_configuration(
            links, {name: transform(*pose) for name, pose in bodies.items()}
        )

    measured = jax.vmap(one)(
        {name: (history.rotation, history.origin) for name, history in histories.items()}
    )
    away = [
        _lean_of_joint(trajectory, joint.name) if joint.permanent else deviation
        for joint, deviation in zip(links.joints, measured.deviations, strict=True)
    ]
    return ChainConfiguration(measured.motions, tuple(away))


def _lean_of_joint(trajectory: Trajectory, name: str) -> Any:
    """Twists by which a joint that always touches leans in its gap."""
    if name not in trajectory.formulation.contact_joints(trajectory.mechanism):
        return None
    history = trajectory.contact(name)
    tilt = jnp.stack(
        [-history.axis[:, 1], history.axis[:, 0], jnp.zeros_like(history.axis[:, 0])], 1
    )
    return jnp.concatenate([history.offset, tilt], 1)


def tip_errors(
    trajectory: Trajectory, tip: Marker, base: str, through: tuple[str, ...]
) -> tuple[Chain, ChainConfiguration, TipError]:
    """The chain, its configuration, and the error of its tip, over the saving times (first axis).

    Args:
        trajectory: run whose tip is read.
        tip: marker on the last body.
        base: "ground" or a body, from which the tip is seen.
        through: names of connections on the path from base to tip.
    """
    links = chain(trajectory.mechanism, base, tip, through)
    actual = configurations(trajectory, links)
    return links, actual, _errors_at(links, actual)


@compiled_quickly
def _errors_at(links, actual):
    return jax.vmap(lambda now: tip_error(links, now))(actual)


# Components of a twist that displace the tip, and those that turn its z axis.
PLACE, ACROSS = slice(0, 3), slice(3, 5)
# Weakest signal [m, rad] that is told from rounding when shares are formed.
ROUNDING = 1e-15


class PointingError(AbstractShown):
    """Error of a tip over the saving times of a run.

    Twists are linear then angular, in the axes of the nominal tip, whose z axis is the boresight.
    `budget()` gives the contribution of each joint, `sentence()` says it in words,
    `jaxclear.plot.pointing_budget` draws it.

    Args:
        time: saving times [s], shape (time,).
        exact: logarithm of the displacement from the nominal to the actual tip [m, rad], shape
            (time, 6).
        model: its first-order approximation, the sum of `contributions` [m, rad], shape (time, 6).
        contributions: twist of the tip that each joint causes [m, rad], shape (time, 6), by joint.
        plays: these by joint and direction of its play [m, rad], shape (time, 6).
        deviations: twist of each joint from its ideal [m, rad], shape (time, 6), in the bearing's
            axes.
        pointing_angle: angle between the z axes of both tips [rad], shape (time,).
        position_error: distance of the origins of both tips [m], shape (time,).
        names: names of the contributions.
        tip: body of the tip.
        base: body from which the tip is seen.
        warnings: warnings of the run.
    """

    time: np.ndarray
    exact: np.ndarray
    model: np.ndarray
    contributions: dict[str, np.ndarray]
    plays: dict[str, np.ndarray]
    deviations: dict[str, np.ndarray]
    pointing_angle: np.ndarray
    position_error: np.ndarray
    names: tuple[str, ...] = eqx.field(static=True)
    tip: str = eqx.field(static=True)
    base: str = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def budget(self, by_play: bool = False) -> Any:
        """The contribution of each joint to the error.

        A share is the mean over time of the product of the joint's contribution and the model's
        error, divided by the mean square of the latter: shares add up to 1; a negative share marks
        a joint that compensates others.

        Args:
            by_play: True for a row for each direction of play (across the axis, along it, tilt) of
                each joint; False by default.

        Returns:
            A pandas table by joint: root mean square and largest pointing [rad] and position [m],
            shares [1]; its last rows are the model's error and the exact one.
        """
        check_flags("budget", by_play=by_play)
        parts = self.plays if by_play else self.contributions
        rows = {n: self._twist_row(twist) | self._twist_shares(twist) for n, twist in parts.items()}
        rows["model"] = self._twist_row(self.model) | self._twist_shares(self.model)
        unshared = dict.fromkeys(self._twist_shares(self.model), np.nan)
        rows["exact"] = _rms_and_max(self.pointing_angle, self.position_error) | unshared
        return as_table([{"joint": name} | row for name, row in rows.items()], index="joint")

    def to_dataset(self) -> Any:
        """Errors and contributions over the saving times.

        Returns:
            An xarray Dataset with units and provenance.
        """
        twist, over = ("time", "component"), ("time", "joint", "component")
        parts = np.stack([self.contributions[name] for name in self.names], axis=1)
        meaning = "twist of the tip; first three components in m, the others in rad"
        columns = {
            "pointing angle": Column(("time",), self.pointing_angle, "rad"),
            "position error": Column(("time",), self.position_error, "m"),
            "exact": Column(twist, self.exact, "m, rad", meaning),
            "model": Column(twist, self.model, "m, rad", f"{meaning}; first order"),
            "contribution": Column(over, parts, "m, rad", f"{meaning}; of one joint"),
        }
        coordinates = {
            "time": Column(("time",), self.time, "s"),
            "joint": Column(("joint",), list(self.names)),
            "component": Column(("component",), ["x", "y", "z", "about x", "about y", "about z"]),
        }
        about: dict[str, Any] = {"tip": self.tip, "base": self.base, "warnings": self.warnings}
        return dataset(columns, coordinates, what="pointing error", **about)

    def _twist_row(self, twist):
        return _rms_and_max(turn(twist), shift(twist))

    def _twist_shares(self, twist):
        def share(part):
            total = np.mean(np.sum(self.model[:, part] ** 2, axis=1))
            return (
                np.mean(np.sum(twist[:, part] * self.model[:, part], axis=1)) / total
                if total > ROUNDING**2
                else 0.0
            )

        return {"share of pointing [1]": share(ACROSS), "share of position [1]": share(PLACE)}

    @property
    def model_error(self) -> float:
        """Largest difference between the first-order and the exact error [1].

        It is divided by the largest exact error; the larger of the values for rotation and
        displacement is taken.
        """
        return max(_difference(self.model, self.exact, part) for part in (PLACE, slice(3, 6)))

    def sentence(self) -> str:
        """The error and its largest contributions in words.

        Returns:
            The text.
        """
        table = self.budget()
        text = (
            f'The z axis of the tip on "{self.tip}", seen from "{self.base}", is off by '
            f"{_rms_text(self.pointing_angle)} rad"
        )
        text += f" and its origin by {_rms_text(self.position_error)} m."
        parts = table.loc[list(self.names)]
        for what in ("pointing", "position"):
            column = parts[f"share of {what} [1]"]
            if column.abs().max() > 0:
                text += (
                    f' The most in {what} comes from "{column.idxmax()}": '
                    f"{100 * column.max():.3g} % of the mean square."
                )
        return (
            f"{text} The adjoint error model is within {100 * self.model_error:.2g} % of the "
            f"largest exact error.{''.join(f' {warning}' for warning in self.warnings)}"
        )

    def _summary(self):
        return self.sentence()


def turn(twist: np.ndarray) -> np.ndarray:
    """Angle [rad] by which a small twist tilts the tip's z axis."""
    return np.linalg.norm(twist[:, ACROSS], axis=1)


def shift(twist: np.ndarray) -> np.ndarray:
    """Length [m] by which a small twist moves the tip's origin."""
    return np.linalg.norm(twist[:, PLACE], axis=1)


def _rms_and_max(angle, length):
    return {
        "rms pointing [rad]": np.sqrt(np.mean(angle**2)),
        "max pointing [rad]": np.max(angle),
        "rms position [m]": np.sqrt(np.mean(length**2)),
        "max position [m]": np.max(length),
    }


def _difference(model, exact, part):
    largest = np.linalg.norm(exact[:, part], axis=1).max()
    return (
        np.linalg.norm((model - exact)[:, part], axis=1).max() / largest
        if largest > ROUNDING
        else 0.0
    )


def _rms_text(values: np.ndarray) -> str:
    return f"{np.sqrt(np.mean(values**2)):.3g} (rms), {values.max():.3g} (largest)"


@answering
def pointing_error(
    trajectory: Trajectory,
    tip: Marker | str,
    base: str = GROUND,
    *,
    through: str | tuple[str, ...] = (),
) -> PointingError:
    """Error of a tip relative to a base over the saving times of a run, joint by joint.

    The error is that against ideal joints at the coordinates of the run itself: the part that
    clearances cause in an antenna that measures its joint angles. A joint with clearance deviates
    by the motion that the ideal joint of its kind (its `ideal_rows`) would prevent: the tilt of a
    `PlanarJournalBearing` is motion and no error. The model is of first order, for small
    deviations.

    Args:
        trajectory: the run.
        tip: a `Marker`, or the name of a body, whose frame it then is; its z axis is the boresight.
        base: name of the body from which the tip is seen; "ground" by default.
        through: names of connections (or one name) that the chain from base to tip passes, needed
            where there are several chains.

    Returns:
        The `PointingError`.

    Raises:
        ValueError: if there is no such tip, base or chain, or if the chain is not serial.
    """
    required = "a run, as jaxclear.simulate returns it"
    expect(trajectory, Trajectory, "what pointing_error is given", required)
    expect(base, str, "base", "the name of a body")
    links, configuration, errors = tip_errors(
        trajectory, checked_tip(tip), base, checked_through(through)
    )
    twists = zip(links.joints, errors.deviations, strict=True)
    contributions = {joint.name: np.asarray(twist) for joint, twist in twists if not joint.ideal}
    deviations = zip(links.names, configuration.deviations, strict=True)
    return PointingError(
        np.asarray(trajectory.time),
        np.asarray(errors.exact),
        sum(contributions.values(), np.zeros_like(np.asarray(errors.exact))),
        contributions,
        {
            f"{joint.name} {play}": np.asarray(twists[k])
            for k, joint in enumerate(links.joints)
            if not joint.ideal
            for play, twists in errors.plays.items()
        },
        {name: np.asarray(twist) for name, twist in deviations if twist is not None},
        np.asarray(errors.pointing_angle),
        np.asarray(errors.position_error),
        tuple(contributions),
        checked_tip(tip).body,
        base,
        trajectory.warnings,
    )
