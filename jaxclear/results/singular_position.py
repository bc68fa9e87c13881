"""What a run tells of a singular position: where rows of closed loops depend on each other, a
linkage stretched flat, say. There drives do not say which way the linkage goes on, and reactions
are not determined.
"""

import equinox as eqx

from jaxclear.ground.printing import with_text_repr


@with_text_repr
class SingularPosition(eqx.Module):
    """A position of a run at which the drives do not determine the motion of a loop.

    A run that ended there gives `joint` and `time` only.

    Args:
        joint: the joint that closes the loop.
        time: time [s].
        free: the joint whose direction the drives do not determine there.
        drives: joints whose drives act on the loop.
        is_reversed: whether the run left in another direction than inertia requires; None: not
            known.
        speeds: speed of the joint `free` before and after [rad/s, m/s].
    """

    joint: str = eqx.field(static=True)
    time: float = eqx.field(static=True)
    free: str = eqx.field(static=True, default="")
    drives: tuple[str, ...] = eqx.field(static=True, default=())
    is_reversed: bool | None = eqx.field(static=True, default=None)
    speeds: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))

    @property
    def is_passed(self) -> bool:
        """Whether the run continued in the direction that inertia requires."""
        return self.is_reversed is False

    def __str__(self) -> str:
        if not self.free:
            return f'The loop is that through joint "{self.joint}", at about {self.time:.4g} s.'
        drives = " and ".join(f'"{name}"' for name in self.drives)
        plural = "drives" if len(self.drives) > 1 else "drive"
        verb = "do" if len(self.drives) > 1 else "does"
        first = (
            f'At {self.time:.4g} s the loop through joint "{self.joint}" is at a singular position '
            f'(a dead centre): {plural} {drives} {verb} not say which way joint "{self.free}" goes '
            "on there."
        )
        before, after = (f"{speed:.3g}" for speed in self.speeds)
        if self.is_reversed is None:
            return f"{first} Saved states do not tell which way it went: save more often."
        if self.is_reversed:
            sentence = f"The run turned it round, its speed from {before} to {after}"
            return f"{first} {sentence}; nothing pushed it."
        return f"{first} It went on as its inertia has it."


def sentences_of(positions: tuple[SingularPosition, ...]) -> tuple[str, ...]:
    """A sentence for the first singular position of each loop and kind, with the number of others.

    Args:
        positions: singular positions in the order of time.

    Returns:
        The sentences.
    """
    kinds: dict[tuple, list[SingularPosition]] = {}
    for one in positions:
        kinds.setdefault((one.joint, one.free, one.is_reversed), []).append(one)
    sentences = []
    for group in kinds.values():
        more = len(group) - 1
        again = f" So it did {more} more {'time' if more == 1 else 'times'}." if more else ""
        sentences.append(f"{group[0]}{again}")
    return tuple(sentences)
