"""The mechanisms of the papers, ready to run."""

from jaxclear.scenes.antenna import antenna
from jaxclear.scenes.four_bar import four_bar
from jaxclear.scenes.guide import guide

__all__ = ["antenna", "four_bar", "guide"]
