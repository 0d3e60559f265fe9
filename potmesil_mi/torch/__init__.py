"""Depth of field as a layer of torch: gradients of pictures, depths and lenses, with occlusion.

``import potmesil_mi.torch`` needs the extra ``torch``: ``pip install 'potmesil_mi[torch]'``. It has
:func:`potmesil_mi.torch.focus`, for batches of pictures with depth, and
:class:`potmesil_mi.torch.LearnedLens`, a module that learns focus distance and f-number.
"""

from __future__ import annotations

try:
    import torch as _torch  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"torch cannot be imported ({error}); potmesil_mi.torch needs it: "
        "pip install 'potmesil_mi[torch]'"
    ) from None

from .api import focus
from .module import LearnedLens

__all__ = ["LearnedLens", "focus"]
