"""Cases of the attack."""

import jaxclear as jc
from benchmarks.attacks.structures import structures


def run_of(structure, draw, integrator, balance=False, verify=None):
    """A run of the mechanism with this number, with its numbers of a draw."""
    case = structures()[structure].case(draw)
    return jc.simulate(
        case.mechanism,
        case.duration,
        integrator=integrator,
        save=201,
        state=jc.State(concentric=case.concentric),
        balance=balance,
        verify=verify,
    )
