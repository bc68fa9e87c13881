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
def bar(visible: bool, label: str, total: float = 1.0) -> Iterator[Part]:
    """Shows a progress bar while the block runs; nested or hidden bars do nothing.

    Args:
        visible: whether it is shown.
        label: text in front of the bar.
        total: known work, in units of one run.

    Yields:
        A function of an amount of work; in the block `with part(work):` a run advances by that
        much.
    """
    if not visible or _bars:
        yield lambda work: nullcontext()
        return
    layout = "{l_bar}{bar}| {elapsed}<{remaining}"
    with tqdm(total=total, desc=label, bar_format=layout) as widget:
        _bars.append((widget, [1.0]))
        try:
            yield _advance_during
        finally:
            widget.update(widget.total - widget.n)
            _bars.pop()


@contextmanager
def _advance_during(work: float) -> Iterator[None]:
    widget, of_now = _bars[-1]
    first = widget.n
    widget.total, of_now[0] = max(widget.total, first + work), work
    yield
    # What told nothing on its way, and what fell short of its end.
    _move_bar_to(widget, first + work)


def advance(share) -> None:
    """Moves the bar by a share of what runs now."""
    if not _bars:
        return
    widget, (work,) = _bars[-1]
    if widget.n == 0:
        # What is left is not told by how long the program took to be compiled.
        widget.unpause()
    _move_bar_to(widget, widget.n + work * float(share))


def _move_bar_to(widget: tqdm, place: float) -> None:
    """Moves a bar so far, never back."""
    widget.update(max(min(place, NEARLY * widget.total) - widget.n, 0.0))
