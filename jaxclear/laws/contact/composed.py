"""Laws of contact: an elastic force times a dissipation factor, with the names of the usual
products; a damper beside the spring, without prescribed restitution; and contact without
compliance.

Any force of `elastic` or `cylinder` goes with any factor of `dissipation`, or with none.
"""

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any, ClassVar

import jax.numpy as jnp

from jaxclear.ground.numerics import positive_part, power, smooth_step
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.ground.wording import listed, meant
from jaxclear.laws.contact import cylinder, dissipation, elastic
from jaxclear.laws.contact.base import (
    AbstractContactLaw,
    AbstractDissipation,
    AbstractElasticForce,
    AbstractNormalLaw,
    exponent_field,
    stiffness_field,
)
from jaxclear.laws.stiffness import Fitted


class ImpactMemory(AbstractQuantified):
    """Least impact speed of a law whose dissipation factor depends on the speed of first touch.

    The integrators supply that speed at the touch itself.

    Args:
        slowest_impact: least impact speed [m/s], > 0: slower impacts are damped as if at this
            speed, so that rest is no division by 0.
    """

    slowest_impact: Scalar = quantity(1e-3, "m/s", above=0)


class ContactForce(AbstractContactLaw):
    r""":math:`F = F_{el}(\delta)\,\max(0, 1 + \lambda\dot\delta)`: an elastic force and the loss
    that goes with it.

    The numbers of the parts are numbers of the law: `law.stiffness` is `law.elastic.stiffness`.

    Args:
        elastic: elastic force, of `contact.elastic` or `contact.cylinder`, or another
            `AbstractElasticForce`.
        dissipation: dissipation factor, an `AbstractDissipation` of `contact.dissipation`; None: no
            loss.
        memory: `ImpactMemory` with the least impact speed; filled in by default where the factor
            depends on the impact speed.

    Raises:
        ValueError: if a memory is given and the factor does not depend on the impact speed.

    Source: Hunt & Crossley 1975, J. Appl. Mech. 42, 440, doi:10.1115/1.3423596; that the rebound
    depends on the factor alone, Gonthier, McPhee, Lange & Piedbœuf 2004, Multibody Syst. Dyn. 11,
    209, doi:10.1023/B:MUBO.0000029392.21648.bc.
    """

    elastic: AbstractElasticForce
    dissipation: AbstractDissipation | None
    memory: ImpactMemory | None

    def __init__(
        self,
        elastic: AbstractElasticForce,
        dissipation: AbstractDissipation | None = None,
        memory: ImpactMemory | None = None,
    ):
        remembers = (
            isinstance(dissipation, AbstractDissipation) and dissipation.remembers_impact_speed
        )
        if isinstance(memory, ImpactMemory) and not remembers:
            raise ValueError(
                "this contact law has a slowest_impact, but no dissipation factor "
                "that asks for the impact speed; leave it out."
            )
        self.elastic, self.dissipation = elastic, dissipation
        self.memory = ImpactMemory() if remembers and memory is None else memory

    def __getattr__(self, name: str) -> Any:
        # While it is unpickled it has no parts yet.
        if name.startswith("_") or name in ("elastic", "dissipation", "memory"):
            raise AttributeError(name)
        for part in (self.elastic, self.dissipation, self.memory):
            if name in _fields(type(part)):
                return getattr(part, name)
        numbers = [
            n for p in (self.elastic, self.dissipation, self.memory) for n in _fields(type(p))
        ]
        raise AttributeError(
            f"a contact law of these parts has no {name}; it has {listed(numbers)}."
        )

    @property
    def restitution(self) -> Scalar | None:
        """Coefficient of restitution [1]: what the factor prescribes, 1 without loss."""
        return 1.0 if self.dissipation is None else self.dissipation.restitution

    @property
    def lossless(self) -> bool:
        return self.dissipation is None

    @property
    def remembers_impact_speed(self) -> bool:
        return self.memory is not None

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        force = self.elastic_force(indentation)
        if self.dissipation is None:
            return force
        if self.memory is not None:
            impact_speed = jnp.maximum(impact_speed, self.memory.slowest_impact)
        return force * positive_part(1 + self.dissipation.relative_damping(rate, impact_speed))

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.elastic.force(indentation)


def _fields(kind: type) -> dict[str, Any]:
    """Fields of a part by name; none where there is no part."""
    return {f.name: f for f in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else {}


def _split_docstring(part: type) -> tuple[str, str, str]:
    """Prose, entries of `Args:` and source of a part's docstring."""
    prose, _, rest = (inspect.getdoc(part) or "").partition("\n\nArgs:\n")
    entries, _, source = rest.partition("\n\n")
    return prose, entries, source


def _builder(
    name: str, force: type[AbstractElasticForce], factor: type[AbstractDissipation] | None = None
) -> Callable[..., ContactForce]:
    """What a user calls `name`: a `ContactForce` from the numbers of its parts. Without a factor of
    its own it is lossless, or, with a `restitution`, has that of CarvalhoMartins.
    """
    loss: type[AbstractDissipation] = factor or dissipation.CarvalhoMartins
    parts = (force, loss, ImpactMemory) if loss.remembers_impact_speed else (force, loss)
    fields = {number: field for part in parts for number, field in _fields(part).items()}

    def build(*slots: Any, **numbers: Any) -> ContactForce:
        unknown = sorted(set(numbers).difference(fields))
        if unknown:
            raise ValueError(
                f"contact.{name} has no number {', '.join(unknown)}; it takes {listed(fields)}."
                f"{meant(unknown[0], fields)}"
            )
        elastic_numbers, lossy, remembered = (
            {number: value for number, value in numbers.items() if number in _fields(part)}
            for part in (force, loss, ImpactMemory)
        )
        lossless = factor is None and lossy.get("restitution") is None
        return ContactForce(
            force(*slots, **elastic_numbers),
            None if lossless else loss(**lossy),
            ImpactMemory(**remembered) if remembered else None,
        )

    build.__name__ = build.__qualname__ = name
    with_loss = " times" if factor else " without loss, or, with a `restitution`, times"
    prose, _, source = _split_docstring(factor or force)
    entries = "\n".join(_split_docstring(part)[1] for part in parts)
    build.__doc__ = (
        f"Elastic force `{force.__name__}`{with_loss} dissipation factor `{loss.__name__}`."
        f"\n\n{prose}\n\nArgs:\n{entries}\n\n{source}"
    )
    parameters = {n: p for part in parts for n, p in inspect.signature(part).parameters.items()}
    if factor is None:
        parameters["restitution"] = parameters["restitution"].replace(default=None)
    build.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [parameters[n].replace(kind=inspect.Parameter.KEYWORD_ONLY) for n in fields]
    )
    build.fields = fields  # type: ignore[attr-defined]
    return build


Hertz = _builder("Hertz", elastic.Hertz)
Linear = _builder("Linear", elastic.Linear)
BallInSocket = _builder("BallInSocket", elastic.BallInSocket)
Johnson = _builder("Johnson", cylinder.Johnson)
TwoSidedJohnson = _builder("TwoSidedJohnson", cylinder.TwoSidedJohnson)
Radzimovsky = _builder("Radzimovsky", cylinder.Radzimovsky)
Goldsmith = _builder("Goldsmith", cylinder.Goldsmith)
Liu = _builder("Liu", cylinder.Liu)
BaiZhao = _builder("BaiZhao", cylinder.BaiZhao, dissipation.ZhiyingQishao)
HuntCrossley = _builder("HuntCrossley", elastic.Hertz, dissipation.HuntCrossley)
LankaraniNikravesh = _builder("LankaraniNikravesh", elastic.Hertz, dissipation.LankaraniNikravesh)
HerbertMcWhannell = _builder("HerbertMcWhannell", elastic.Hertz, dissipation.HerbertMcWhannell)
Flores = _builder("Flores", elastic.Hertz, dissipation.Flores)
ModifiedFlores = _builder("ModifiedFlores", elastic.BallInSocket, dissipation.Flores)
HuGuo = _builder("HuGuo", elastic.Hertz, dissipation.HuGuo)
ZhiyingQishao = _builder("ZhiyingQishao", elastic.Hertz, dissipation.ZhiyingQishao)
CarvalhoMartins = _builder("CarvalhoMartins", elastic.Hertz, dissipation.CarvalhoMartins)
Gonthier = _builder("Gonthier", elastic.Hertz, dissipation.Gonthier)
MarhefkaOrin = _builder("MarhefkaOrin", elastic.Hertz, dissipation.MarhefkaOrin)


class KelvinVoigt(AbstractContactLaw):
    r""":math:`F = \max(0, K\delta + D\,s(\delta)\,\dot\delta)`, s a cubic step from 0 at touch to 1
    at `onset_depth`.

    The textbook law (s = 1) jumps by :math:`D\dot\delta` at touch and pulls before it opens; the
    step and the clamp remove both, at the price of slightly less loss. Rebound
    :math:`\exp(-\pi\zeta/\sqrt{1 - \zeta^2})` with :math:`\zeta = D/(2\sqrt{K m})` only while
    `onset_depth` is far below the deepest indentation. Prefer a Hertzian law for metal on metal.

    Args:
        stiffness: spring stiffness K [N/m], > 0; a number or a fit.
        damping: damper coefficient D [N s/m], >= 0.
        onset_depth: indentation at which the damper acts in full [m], > 0.

    Source: Goldsmith 1960, Impact; Flores & Lankarani 2016, Contact Force Models, ch. 3,
    doi:10.1007/978-3-319-30897-5.
    """

    stiffness: Fitted = quantity(1e8, "N/m", above=0)
    damping: Scalar = quantity(1e3, "N s/m", at_least=0)
    onset_depth: Scalar = quantity(1e-7, "m", above=0)
    restitution: ClassVar[None] = None
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        damper = self.damping * smooth_step(indentation, 0.0, self.onset_depth) * rate
        return positive_part(self.elastic_force(indentation) + damper)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * positive_part(indentation)


class AdamsImpact(AbstractContactLaw):
    r"""The IMPACT function of Adams: :math:`F = \max(0, K\delta^n + \mathrm{STEP}(\delta, 0, 0,
    d_{max}, c_{max})\,\dot\delta)`.

    Loss depends on mass and speed; no restitution is prescribed. Made to run, not to predict:
    prefer CarvalhoMartins where the rebound matters.

    Args:
        stiffness: generalized contact stiffness K [N/m^exponent], > 0.
        exponent: exponent of the indentation [1], > 1; None: Hertz's 3/2.
        damping: largest damping coefficient c_max [N s/m], >= 0.
        full_damping_depth: indentation d_max at which damping is largest [m], > 0.

    Source: MSC Adams/Solver, IMPACT; Wan, Liu, Ma & Tong, "Investigation on Dynamic Interaction of
    Multiple Clearance Joints for Flap Actuation System", eq. 6. Misprints there: the first case
    (delta <= 0) must be 0, not K delta^1.5, the third holds from delta = d_max on, the force must
    be clamped at 0 as Adams does, and "c_max is about one percent of the stiffness" equates N s/m
    with N/m^1.5 (a habit of numbers in N and mm, not a law).
    """

    stiffness: Fitted = stiffness_field()
    exponent: Scalar | None = exponent_field()
    damping: Scalar = quantity(1e3, "N s/m", at_least=0)
    full_damping_depth: Scalar = quantity(1e-5, "m", above=0)
    restitution: ClassVar[None] = None
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        damper = smooth_step(indentation, 0.0, self.full_damping_depth, 0.0, self.damping) * rate
        return positive_part(self.elastic_force(indentation) + damper)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class Rigid(AbstractNormalLaw):
    """No stiffness, no function of the indentation: for integrator.MoreauJean and NonColliding.

    An impact in which one contact closes ends with restitution times the speed before (Newton).
    Where a force is wanted as a function, take CarvalhoMartins.

    Args:
        restitution: coefficient of restitution c_e [1], >= 0 and <= 1.

    Source: Newton 1687, Principia; as a complementarity of percussion and velocity Moreau 1988, in
    Nonsmooth Mechanics and Applications, 1, doi:10.1007/978-3-7091-2624-0_1.
    """

    restitution: Scalar = quantity(0.9, "1", at_least=0, at_most=1)
    compliant: ClassVar[bool] = False
    remembers_impact_speed: ClassVar[bool] = False

    def elastic_force(self, indentation: Scalar) -> Scalar:
        """Nothing is stored."""
        return 0.0
