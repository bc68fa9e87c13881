"""What a run tells of a singular position: where rows of closed loops depend on each other, a
linkage stretched flat, say. There drives do not say which way the linkage goes on, and reactions
are not determined."""

import equinox as eqx

from jaxclear.ground.shown import shown_in_words

__all__ = ["SingularPosition", "in_sentences"]


@shown_in_words
class SingularPosition(eqx.Module):
    """A singular position of a run, at the `time` [s]: the loop is the one that `joint` closes.

    `free`: the joint of which drives do not say how it goes on there, with its `speeds` before and
    after [rad/s, m/s]; `turned`: whether the run left by another way than that by which its inertia
    leads on (None: not known). `drives`: joints whose drives hold the loop. A run that ended there
    tells `joint` and `time` alone.
    """

    joint: str = eqx.field(static=True)
    time: float = eqx.field(static=True)
    free: str = eqx.field(static=True, default="")
    drives: tuple[str, ...] = eqx.field(static=True, default=())
    turned: bool | None = eqx.field(static=True, default=None)
    speeds: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))

    @property
    def passed(self) -> bool:
        """Whether the run went on as its inertia has it."""
        return self.turned is False

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
        if self.turned is None:
            return f"{first} Saved states do not tell which way it went: save more often."
        if self.turned:
            turned = f"The run turned it round, its speed from {before} to {after}"
            return f"{first} {turned}; nothing pushed it."
        return f"{first} It went on as its inertia has it."


def in_sentences(found: tuple[SingularPosition, ...]) -> tuple[str, ...]:
    """A sentence for the first of each loop and kind, and how many more there are."""
    kinds: dict[tuple, list[SingularPosition]] = {}
    for one in found:
        kinds.setdefault((one.joint, one.free, one.turned), []).append(one)
    told = []
    for alike in kinds.values():
        more = len(alike) - 1
        again = f" So it did {more} more {'time' if more == 1 else 'times'}." if more else ""
        told.append(f"{alike[0]}{again}")
    return tuple(told)
