"""The mechanisms of the papers, a slider-crank and a robot arm, ready to run."""

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.scenes.antenna import antenna
from jaxclear.scenes.arm import arm
from jaxclear.scenes.flap import flap
from jaxclear.scenes.four_bar import four_bar
from jaxclear.scenes.guide import guide
from jaxclear.scenes.parallel_3rsr import parallel_3rsr
from jaxclear.scenes.slider_crank import slider_crank

__all__ = ["antenna", "arm", "flap", "four_bar", "guide", "parallel_3rsr", "slider_crank"]
__getattr__, __dir__ = nothing_else("jaxclear.scenes", __all__)
