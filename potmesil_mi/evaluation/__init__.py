"""How good a picture is and how long it takes, beside a ray-traced lens."""

from .comparison import Comparison, Rendering, compare
from .search import EqualError
from .thinlens import thinlens_sensor

__all__ = ["Comparison", "EqualError", "Rendering", "compare", "thinlens_sensor"]
