"""Probabilities from design points alone: FORM takes limits for planes, SORM for paraboloids.

Neither knows its own error; sampling tells it. A system of planes is integrated by sampling the
planes, which costs no runs.

Source: Breitung 1984, J. Eng. Mech. 110, 357, doi:10.1061/(ASCE)0733-9399(1984)110:3(357); Tvedt
1983, Det Norske Veritas RDIV/20-004-83 (three terms), as given by Melchers & Beck 2018, Structural
Reliability Analysis and Prediction, doi:10.1002/9781119266105.
"""

import numpy as np
import scipy

from jaxclear.studies.reliability.design_point import DesignPoint
from jaxclear.studies.reliability.importance import Proposal
from jaxclear.studies.reliability.models import AbstractModel
from jaxclear.studies.scrambling import scrambled_normal

# Points at which a system of planes is looked at.
POINTS = 1 << 16
# Width of differences of slopes [deviations]. A limit that is a sphere about the middle, but for
# what these leave, bends around it.
WIDTH = 0.02


def form(points: list[DesignPoint]) -> float:
    """Probability [1] that any design point's limits, taken for planes, are broken."""
    return _planes(points, [point.betas for point in points])


def curvatures(model: AbstractModel, point: DesignPoint) -> np.ndarray:
    """Principal curvatures (variables - 1,) [1/deviation] of the one limit at a design point,
    negative where the failing side bends towards the middle; by central differences of slopes.
    """
    count = len(point.normal)
    moved = WIDTH * np.eye(count)
    where = np.concatenate([point.normal + moved, point.normal - moved])
    slopes = model.slopes(where)[1][:, point.cut[0]]
    hessian = (slopes[:count] - slopes[count:]) / (2 * WIDTH)
    hessian = 0.5 * (hessian + hessian.T) / point.slopes[0]
    # A basis whose first vector is the direction outward.
    basis = np.linalg.qr(np.column_stack([point.directions[0], np.eye(count)]))[0][:, 1:count]
    return np.linalg.eigvalsh(basis.T @ hessian @ basis)


def breitung(beta: float, bends: np.ndarray) -> float:
    """Probability [1] beyond a paraboloid at distance beta, for large beta; nan where it bends
    around the middle."""
    inside = 1.0 + beta * bends
    if not (inside > WIDTH**2).all():
        return np.nan
    return float(scipy.special.ndtr(-beta) / np.sqrt(np.prod(inside)))


def tvedt(beta: float, bends: np.ndarray) -> float:
    """As `breitung`, with two more terms; nan where it does not apply."""
    if not ((1.0 + beta * bends) > WIDTH**2).all() or not ((1.0 + (beta + 1) * bends) > 0).all():
        return np.nan
    product = lambda at: 1.0 / np.sqrt(np.prod(1.0 + at * bends, dtype=complex))
    density = np.exp(-0.5 * beta**2) / np.sqrt(2 * np.pi)
    rest = beta * scipy.special.ndtr(-beta) - density
    first = scipy.special.ndtr(-beta) * product(beta)
    second = rest * (product(beta) - product(beta + 1))
    third = (beta + 1) * rest * (product(beta) - np.real(product(beta + 1j)))
    probability = float(np.real(first + second + third))
    return probability if 0 < probability < 1 else np.nan


def sorm(points: list[DesignPoint], bends: list[np.ndarray]) -> tuple[float, float]:
    """Probabilities [1] by Breitung and Tvedt: planes moved to where each alone has the probability
    of its paraboloid."""
    answers = []
    for formula in (breitung, tvedt):
        betas = [formula(p.beta, kappa) for p, kappa in zip(points, bends, strict=True)]
        if not np.all(np.isfinite(betas)):
            answers.append(np.nan)
            continue
        answers.append(_planes(points, [np.array([-scipy.special.ndtri(p)]) for p in betas]))
    return answers[0], answers[1]


def _planes(points: list[DesignPoint], betas: list[np.ndarray]) -> float:
    """Probability [1] of a system of planes at these distances."""
    if len(points) == 1 and len(betas[0]) == 1:
        return float(scipy.special.ndtr(-betas[0][0]))
    proposal = Proposal.at([p.normal for p in points], [p.beta for p in points])
    rng = np.random.default_rng(0)
    normal = proposal.drawn(scrambled_normal(POINTS, proposal.dimensions, rng))
    fails = np.zeros(POINTS, bool)
    for point, beta in zip(points, betas, strict=True):
        fails |= np.all(normal @ point.directions.T >= beta, axis=1)
    return float(np.mean(fails * proposal.weights(normal)))
