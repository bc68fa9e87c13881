"""How the solution of a complementarity problem can end."""

from jaxclear.ground.outcome import AbstractOutcome

__all__ = ["Outcome"]


class Outcome(AbstractOutcome):
    """How a solve ended. `Outcome(code).sentence` says it; only `SOLVED` (0) is a success."""

    SOLVED = 0, "The problem is solved to the solver's tolerance."
    RAY = (
        1,
        "The path ended on a ray: there is no solution if the matrix is copositive-plus (positive "
        "semidefinite, say); otherwise this path finds none.",
    )
    LIMIT = 2, "The allowed number of iterations was used up."
    STALLED = (
        3,
        "No step lowers the residual any further: there is no solution nearby, or the data are too "
        "ill-conditioned.",
    )
    NOT_FINITE = (
        4,
        "The data, or what follows from them, are infinite, not a number or out of range.",
    )
