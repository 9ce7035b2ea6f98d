"""Clip positions for programs that clip nothing."""

import numpy as np


def refuse_clipping(clip: np.ndarray) -> None:
    """Raise `ValueError` unless every corner lies between the near plane and infinity: 0 < w and 0 <= z <= w."""
    if not np.all((clip[:, 3] > 0) & (clip[:, 2] >= 0) & (clip[:, 2] <= clip[:, 3])):
        raise ValueError("it does not clip, and a corner lies before the near plane or beyond the far one")
