"""The coefficient of restitution that a contact law is built around: what rigid contact takes from
a compliant law.
"""

from jaxclear.ground.quantity import Scalar
from jaxclear.laws import conformal, contact

PRESCRIBED = (
    contact.Rigid,
    contact.HuntCrossley,
    contact.LankaraniNikravesh,
    contact.Flores,
    contact.Gonthier,
    contact.CarvalhoMartins,
    contact.ModifiedFlores,
    conformal.BaiZhao,
)
OPTIONAL = (
    conformal.Johnson,
    conformal.TwoSidedJohnson,
    conformal.Radzimovsky,
    conformal.Goldsmith,
    conformal.Liu,
)


def restitution(law: contact.AbstractNormalLaw) -> Scalar | None:
    """Coefficient of restitution of a law; 1 for one without loss, None where it depends on mass
    and speed.
    """
    if isinstance(law, PRESCRIBED):
        return law.restitution
    if isinstance(law, OPTIONAL):
        return 1.0 if law.restitution is None else law.restitution
    return 1.0 if isinstance(law, contact.Hertz) else None
