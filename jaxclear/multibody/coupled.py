"""What a coupling is refused for, in sentences that name it and say what would be right."""

from typing import Any

import numpy as np

from jaxclear.components.coupling import AbstractCoordinateCoupling
from jaxclear.components.joint.base import drive_of
from jaxclear.ground.arguments import check_known
from jaxclear.ground.quantity import is_traced
from jaxclear.ground.warning import warn
from jaxclear.ground.wording import listed
from jaxclear.multibody.meshes import drawn_pose, markers
from jaxclear.multibody.topology import Topology, coordinate_joint
from jaxclear.multibody.validation import one_coordinate

__all__ = ["check_couplings"]

# Beside factors of couplings [1].
ROUNDING = 1e-9


def check_couplings(couplings: dict, topology: Topology, bodies: dict, connections: dict) -> None:
    """Raises `ValueError` for a coupling of joints that there are not, or that do not fit."""
    _warn_of_locks(couplings)
    for name, coupling in couplings.items():
        if name in connections:
            raise ValueError(f'"{name}" is a coupling and a joint; give one of them another name.')
        names = coupling.joints()
        for joint in names:
            if names.count(joint) > 1:
                raise ValueError(
                    f'coupling "{name}" names joint "{joint}" twice; it couples different joints.'
                )
            check_known("joint", joint, connections, f' for coupling "{name}"')
        if isinstance(coupling, AbstractCoordinateCoupling):
            _check_coordinates(name, coupling, topology, bodies, connections)
            continue
        first, second = markers(coupling, connections)
        if first.body == second.body:
            raise ValueError(
                f'coupling "{name}" ties body "{first.body}" to itself; its joints '
                f"{listed(names)} carry one body."
            )
        _check_moves(name, coupling, bodies, connections)
        if not is_traced((coupling, bodies, connections)):
            try:
                coupling.check(drawn_pose(coupling, bodies, connections))
            except ValueError as error:
                raise ValueError(f'coupling "{name}" {error}') from None


def _warn_of_locks(couplings: dict) -> None:
    """Warns where sums of coordinates, each of two or more joints, leave a joint one place only."""
    own = {n: c.terms() for n, c in couplings.items() if isinstance(c, AbstractCoordinateCoupling)}
    if len(own) < 2 or is_traced(own):
        return
    joints = list(dict.fromkeys(term.joint for terms in own.values() for term in terms))
    rows = np.zeros((len(own), len(joints)))
    for row, terms in zip(rows, own.values(), strict=True):
        for joint, factor in terms:
            row[joints.index(joint)] = float(factor)
    for place, joint in zip(np.eye(len(joints)), joints, strict=True):
        shares = np.linalg.lstsq(rows.T, place, rcond=None)[0]
        tying = [n for n, share in zip(own, shares, strict=True) if abs(share) > ROUNDING]
        if len(tying) > 1 and np.allclose(rows.T @ shares, place, atol=ROUNDING):
            warn(
                f'couplings {listed(tying)} together leave joint "{joint}" one place only: they '
                "contradict each other in motion, and nothing that they tie can move. Leave one of "
                "them out."
            )
            return


def _check_moves(name: str, coupling: Any, bodies: dict, connections: dict) -> None:
    """That the joints leave free what the coupling ties; a part may be held by a fixed one."""
    says = {"rad": "turn", "m": "slide"}
    for joint, needed in zip(coupling.joints(), coupling.moves(), strict=True):
        ideal = coordinate_joint(joint, bodies, connections)
        left = [says[unit] for unit in needed if unit not in ideal.units]
        if left and ideal.units:
            raise ValueError(
                f'coupling "{name}", a {type(coupling).__name__}, needs a joint "{joint}" whose '
                f"parts {' and '.join(says[unit] for unit in needed)}; those of a "
                f"{type(connections[joint].joint).__name__} do not {' and '.join(left)}."
            )


def _check_coordinates(
    name: str, coupling: Any, topology: Topology, bodies: dict, connections: dict
) -> None:
    """That the joints have one coordinate each, of which one at least is free, and one at most is
    an angle outside the tree."""
    driven, uncounted = [], []
    for place in coupling.joints():
        joint = one_coordinate(f'coupling "{name}" speaks of', place, bodies, connections)
        driven += [place] if drive_of(joint) is not None else []
        outside = topology.branch_of(place) is None
        uncounted += [place] if outside and joint.units == ("rad",) else []
    if len(driven) == len(coupling.joints()):
        raise ValueError(
            f'coupling "{name}" ties joints {listed(driven)}, all of which are driven; leave one '
            "of the drives out."
        )
    if len(uncounted) > 1:
        raise ValueError(
            f'coupling "{name}" ties joints {listed(uncounted)}, whose whole turns are not counted '
            "because the tree does not carry them (they have clearance or close loops); one at "
            "most may be such a joint. Couple the bodies in their place (jaxclear.coupling.Gear)."
        )
