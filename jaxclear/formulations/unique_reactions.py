"""Whether statics tells what joints carry that touch all the time: not where rows of loops are
redundant, or where no motion changes them.
"""

from jaxclear.formulations.permanent_reactions import (
    PermanentJoint,
    Reaction,
    reaction_of_link,
    touching,
)
from jaxclear.multibody import constraints
from jaxclear.multibody.system import System


class ReactionNotUnique(ValueError):
    """Friction would hang on a reaction that is not unique."""


def check_unique(system: System) -> None:
    """Raises `ReactionNotUnique` where friction would hang on a reaction that is not unique."""
    redundancy = system.topology.redundancy
    for held in touching(system):
        rubs = held.joint.friction is not None and held.joint.follows_reaction
        if redundancy is not None and rubs and held.name in redundancy.joints:
            raise ReactionNotUnique(
                f'friction in joint "{held.name}" follows its reaction, which is not unique: the '
                f"loops are {redundancy} Leave its friction out, give another joint of this loop "
                "more freedom, or take a compliant integrator such as ImplicitStep."
            )


def reactions_without_motion(
    system: System, motions: tuple, q: tuple, held: tuple[PermanentJoint, ...], in_space: bool
) -> list[tuple[Reaction, ...]]:
    """For each row of a loop that no motion changes: the reactions of joints that touch to the
    force 1 [N, N m] in it, which is in equilibrium with itself. Unless bodies are `in_space`, those
    alone that are no plain zeros: nothing else is loaded across the plane."""
    answers = []
    for k, closure in enumerate(system.closures):
        found = constraints.constraint_rows(system, motions, closure)
        places = [i for i in range(len(closure.rows)) if i not in found.kept]
        for place in places if in_space else found.fixed:
            own: tuple = tuple({place: 1.0} if j == k else {} for j in range(len(system.closures)))
            closing, through = constraints.wrenches_of_rows(system, motions, own)
            reactions = tuple(
                Reaction(*closing[one.loop])
                if one.loop is not None
                else reaction_of_link(system, one, motions, q, through[one.link])
                for one in held
            )
            answers.append(reactions)
    return answers
