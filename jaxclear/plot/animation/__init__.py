"""A run that moves: bodies in space, and insets that magnify every joint with clearance."""

from jaxclear.plot.animation.animate import Animation, animate

__all__ = ["Animation", "animate"]
