"""What a check is: a figure by which a run is judged, beside its limit."""

import enum

import numpy as np

from jaxclear.integrators.outcome import Outcome

NEVER = (np.inf, Outcome.REACHED)


class AbstractCheck(enum.IntEnum):
    """A figure by which a run is judged: its `label` in tables, `unit`, `limit`, what the limit
    `concerns` (motion, places, forces, peak forces, wear, worn depth, places in gaps), whose it is
    (`of`), and the `sentence` said beyond the limit. Beyond `ends_at` the run ends, by `outcome`.
    """

    label: str
    unit: str
    limit: float
    concerns: str
    of: str
    sentence: str
    ends_at: float
    outcome: Outcome

    def __new__(cls, code, label, limit, concerns, of, sentence, ends=NEVER, unit="1"):
        member = int.__new__(cls, code)
        member._value_ = code
        member.label, member.unit, member.limit = label, unit, limit
        member.concerns, member.of, member.sentence = concerns, of, sentence
        member.ends_at, member.outcome = ends
        return member
