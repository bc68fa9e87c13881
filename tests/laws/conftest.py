"""float64 for the laws' tests, even when only `jaxclear.laws` is imported."""

import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parent))
