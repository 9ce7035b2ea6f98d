"""Transparency's twin in NumPy: every pixel's fragments sorted, looked at one by one, laid over each other in double
precision."""

import numpy as np

OPAQUE, MASK, BLEND = 0, 1, 2


def layers(face: np.ndarray, alpha: np.ndarray, mode: np.ndarray, cutoff: np.ndarray, most: int):
    """(kept fragments, blended ones that were left out) of one pixel, whose fragments `[n]` come nearest first.

    Fragments are given by their place; the last one kept is solid if any is.
    """
    kept, left_out = [], 0
    for place in range(len(face)):
        if mode[place] == MASK and alpha[place] < cutoff[place]:
            continue
        if mode[place] != BLEND:
            return [*kept, place], left_out
        if len(kept) < most:
            kept.append(place)
        else:
            left_out += 1
    return kept, left_out


def over(colors: np.ndarray, alphas: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Σ T α C of fragments `[n, 3]`, nearest first, and the background behind them."""
    total, through = np.zeros(3), 1.0
    for color, alpha in zip(colors, alphas):
        total = total + through * alpha * color
        through *= 1.0 - alpha
    return total + through * background
