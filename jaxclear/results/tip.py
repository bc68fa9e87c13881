"""Error of a tip over the saving times of a run: a marker's pose against that of the same chain
with ideal joints.

The arithmetic of one instant is `multibody.product_of_exponentials`; here it is mapped over a run,
against itself or against another run.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.body import Marker
from jaxclear.ground.arguments import expect
from jaxclear.ground.transform import transform
from jaxclear.ground.wording import described
from jaxclear.multibody.chain import Chain, chain
from jaxclear.multibody.product_of_exponentials import (
    ChainConfiguration,
    TipError,
    measured_configuration,
    tip_error,
)
from jaxclear.results.trajectory import Trajectory

# How far saving times of two runs may differ, as a share of the duration: rounding.
SAME_TIME = 1e-9


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


@eqx.filter_jit
def configurations(trajectory: Trajectory, links: Chain) -> ChainConfiguration:
    """How the joints of a chain stand at every saving time."""
    histories = {name: trajectory.body(name) for name in links.bodies}

    def one(bodies):
        return measured_configuration(
            links, {name: transform(*pose) for name, pose in bodies.items()}
        )

    found = jax.vmap(one)(
        {name: (history.rotation, history.origin) for name, history in histories.items()}
    )
    away = [
        _lean(trajectory, joint.name) if joint.permanent else own
        for joint, own in zip(links.joints, found.deviations, strict=True)
    ]
    return ChainConfiguration(found.motions, tuple(away))


def _lean(trajectory: Trajectory, name: str) -> Any:
    """Twists by which a joint that always touches leans in its gap."""
    if name not in trajectory.formulation.contact_joints(trajectory.mechanism):
        return None
    history = trajectory.contact(name)
    tilt = jnp.stack(
        [-history.axis[:, 1], history.axis[:, 0], jnp.zeros_like(history.axis[:, 0])], 1
    )
    return jnp.concatenate([history.offset, tilt], 1)


def tip_errors(
    trajectory: Trajectory,
    tip: Marker,
    base: str,
    through: tuple[str, ...],
    nominal: Trajectory | None = None,
) -> tuple[Chain, ChainConfiguration, TipError]:
    """The chain, how its joints stand, and the error of its tip, over the saving times (first
    axis).

    `nominal=None`: against ideal joints at the coordinates that the run itself shows; else against
    another run.
    """
    own = chain(trajectory.mechanism, base, tip, through)
    actual = configurations(trajectory, own)
    if nominal is None:
        return own, actual, _errors(own, actual, None, None)
    other = chain(nominal.mechanism, base, tip, through)
    ways, other_ways = (
        [(joint.name, joint.forward) for joint in links.joints] for links in (own, other)
    )
    if ways != other_ways:
        raise ValueError(
            f"the chain of the run goes by {', '.join(own.names)}, that of the nominal run by "
            f"{', '.join(other.names)}; "
            "they must be the same connections, from the same side."
        )
    _check_times(trajectory, nominal)
    return own, actual, _errors(own, actual, other, configurations(nominal, other))


@eqx.filter_jit
def _errors(own, actual, other, nominal):
    return jax.vmap(lambda now, then: tip_error(own, now, other, then))(actual, nominal)


def _check_times(run: Trajectory, nominal: Trajectory) -> None:
    if run.time.shape != nominal.time.shape:
        raise ValueError(
            f"the run has {run.time.shape[0]} saving times, the nominal run "
            f"{nominal.time.shape[0]}; simulate both with the same."
        )
    if isinstance(run.time, jax.core.Tracer) or isinstance(nominal.time, jax.core.Tracer):
        return
    times, others = np.asarray(run.time), np.asarray(nominal.time)
    if np.abs(times - others).max() > SAME_TIME * np.abs(times).max():
        raise ValueError(
            "the run and the nominal run are saved at different times; simulate both with the same "
            "`save`."
        )
