"""One progress bar on the host, moved by the compiled program at every saving time."""

from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

_bars: list[tqdm] = []


@contextmanager
def bar(shown: bool, label: str) -> Iterator[None]:
    """Shows a bar from 0 to 100 % while the block runs; nested or hidden bars do nothing."""
    if not shown or _bars:
        yield
        return
    layout = "{l_bar}{bar}| {elapsed}<{remaining}"
    with tqdm(total=1.0, desc=label, bar_format=layout) as shown_bar:
        _bars.append(shown_bar)
        try:
            yield
        finally:
            shown_bar.update(1.0 - shown_bar.n)
            _bars.pop()


def advance(share) -> None:
    """Moves the bar by a share of the whole."""
    if not _bars:
        return
    shown_bar = _bars[-1]
    if shown_bar.n == 0:
        # What is left is not told by how long the program took to be compiled.
        shown_bar.unpause()
    shown_bar.update(min(float(share), 1.0 - shown_bar.n))
