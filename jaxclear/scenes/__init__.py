"""The mechanisms of the papers, ready to run."""

from jaxclear.scenes.four_bar import four_bar

__all__ = ["four_bar"]
