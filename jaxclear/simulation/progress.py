"""One progress bar on the host, moved by the compiled program at every saving time. What follows a
run (its replicas) is part of the whole; where more follows than was known, the whole grows.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from tqdm import tqdm

# Each with the work, beside that of one run, of which shares are told now.
_bars: list[tuple[tqdm, list[float]]] = []
# Share of the whole up to which a bar goes while something may follow.
NEARLY = 0.99

Part = Callable[[float], AbstractContextManager[None]]


@contextmanager
def bar(shown: bool, label: str, whole: float = 1.0) -> Iterator[Part]:
    """Shows a bar from 0 to 100 % while the block runs; nested or hidden bars do nothing. `whole`:
    the work that is known of, beside that of one run. Gives what says, `with part(work):`, that
    what runs within is so much of it."""
    if not shown or _bars:
        yield lambda work: nullcontext()
        return
    layout = "{l_bar}{bar}| {elapsed}<{remaining}"
    with tqdm(total=whole, desc=label, bar_format=layout) as shown_bar:
        _bars.append((shown_bar, [1.0]))
        try:
            yield _part
        finally:
            shown_bar.update(shown_bar.total - shown_bar.n)
            _bars.pop()


@contextmanager
def _part(work: float) -> Iterator[None]:
    shown_bar, of_now = _bars[-1]
    begun = shown_bar.n
    shown_bar.total, of_now[0] = max(shown_bar.total, begun + work), work
    yield
    # What told nothing on its way, and what fell short of its end.
    _to(shown_bar, begun + work)


def advance(share) -> None:
    """Moves the bar by a share of what runs now."""
    if not _bars:
        return
    shown_bar, (work,) = _bars[-1]
    if shown_bar.n == 0:
        # What is left is not told by how long the program took to be compiled.
        shown_bar.unpause()
    _to(shown_bar, shown_bar.n + work * float(share))


def _to(shown_bar: tqdm, place: float) -> None:
    """Moves a bar so far, never back."""
    shown_bar.update(max(min(place, NEARLY * shown_bar.total) - shown_bar.n, 0.0))
