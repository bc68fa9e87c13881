"""How something that a compiled program does can end: numbers while it runs, sentences when a user
reads them."""

import enum

__all__ = ["AbstractOutcome"]


class AbstractOutcome(enum.IntEnum):
    """A family of outcomes: each member is a number, which compiled programs compare, and has a
    `sentence`."""

    sentence: str

    def __new__(cls, code: int, sentence: str = ""):
        member = int.__new__(cls, code)
        member._value_ = code
        member.sentence = sentence
        return member
