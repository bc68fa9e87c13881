"""What every figure must have: something drawn with finite numbers, and a name at every axis."""

import io

import numpy as np


def _beside(axis, which):
    """The axis, those that share its scale, and those in its column (for x) or its row (for y)."""
    shared = getattr(axis, f"get_shared_{which}_axes")().get_siblings(axis)
    span = "colspan" if which == "x" else "rowspan"
    gridded = [other for other in axis.figure.axes if other.get_subplotspec() is not None]
    if axis not in gridded:
        return shared
    own = getattr(axis.get_subplotspec(), span)
    return shared + [one for one in gridded if getattr(one.get_subplotspec(), span) == own]


def _named(axis, which):
    """Whether one of them says what is counted: a label, or ticks with words."""
    for one in _beside(axis, which):
        ticks = [tick.get_text() for tick in getattr(one, f"get_{which}ticklabels")()]
        if getattr(one, f"get_{which}label")() or any(word[:1].isalpha() for word in ticks):
            return True
    return False


def assert_complete(figure):
    """Save the figure and look at every pair of axes in it."""
    figure.savefig(io.BytesIO(), format="png")
    assert figure.axes
    for axis in figure.axes:
        assert axis.has_data(), f"nothing is drawn in {axis}"
        for line in axis.get_lines():
            drawn = np.asarray(line.get_xydata(), float)
            assert drawn.size and np.isfinite(drawn).any(), f"a line of {axis} has no finite point"
        for which in "xy":
            if len(getattr(axis, f"get_{which}ticks")()):
                assert _named(axis, which), f"the {which} axis of {axis} has no name"
