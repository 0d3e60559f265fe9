"""How good a picture is and how long it takes, beside a ray-traced lens."""

from .comparison import compare
from .report import Comparison, Rendering
from .search import EqualError
from .thinlens import thinlens_sensor

__all__ = ["Comparison", "EqualError", "Rendering", "compare", "thinlens_sensor"]
