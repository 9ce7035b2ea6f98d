"""Generated textures that repeat, as linear RGBA images `[size, size, 4]` for `pack_textures`."""

import numpy as np


def _rgba(rgb: np.ndarray) -> np.ndarray:
    return np.concatenate([rgb, np.ones((*rgb.shape[:2], 1))], axis=-1).astype(np.float32)


def planks(size: int = 256, planks: int = 8) -> np.ndarray:
    """Linear colour of oak planks along u, eight in a square that repeats: grain, tints and dark joints."""
    rng = np.random.default_rng(7)
    # Blur noise along the grain by multiplying its spectrum, which also makes it repeat.
    along, across = np.meshgrid(np.fft.fftfreq(size) * size, np.fft.fftfreq(size) * size)
    spectrum = np.fft.fft2(rng.standard_normal((size, size))) * np.exp(-((along / 4) ** 2) - (across / 90) ** 2)
    grain = np.fft.ifft2(spectrum).real
    grain /= grain.std()
    row, column = np.mgrid[:size, :size]
    plank = row * planks // size
    # Start each plank elsewhere, and make it of two lengths of different wood.
    shifted = (column + rng.integers(0, size, planks)[plank]) % size
    tint = rng.uniform(0.78, 1.12, (planks, 2))[plank, shifted * 2 // size]
    joint = (row % (size // planks) == 0) | (shifted % (size // 2) == 0)
    shade = tint * (1.0 + 0.10 * grain) * np.where(joint, 0.45, 1.0)
    return _rgba(np.clip(shade[..., None] * np.array([0.44, 0.25, 0.12]), 0.0, 1.0))


def weave(size: int = 64, threads: int = 8) -> np.ndarray:
    """A normal map of plain weave, threads going over and under each other; green is up, against the rows."""
    row, column = (np.mgrid[:size, :size] + 0.5) * (threads / size)
    over = (np.floor(row) + np.floor(column)) % 2 == 0
    across, along = np.where(over, row, column) % 1 - 0.5, np.where(over, column, row) % 1 - 0.5
    height = np.cos(np.pi * across) * (0.55 + 0.45 * np.cos(np.pi * along))
    slope_x, slope_down = (0.5 * (np.roll(height, -1, axis) - np.roll(height, 1, axis)) for axis in (1, 0))
    normal = np.stack([-slope_x, slope_down, np.full_like(height, 0.25)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return _rgba(0.5 * normal + 0.5)
