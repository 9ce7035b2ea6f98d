"""DEODR: face id and depth on one core, in double precision.

Needs the package deodr. It takes pixel positions and a depth at each corner, smaller being nearer: 1 - z/w, which is
linear on the screen. The id is drawn as the colour of three corners of the triangle's own, which all have it.
"""

import importlib.metadata

import numpy as np

from .clip import refuse_clipping


class Deodr:
    """A compiled frame of one workload and size."""

    def __init__(self, clip: np.ndarray, faces: np.ndarray, size: int):
        refuse_clipping(clip)
        from deodr import differentiable_renderer

        self.name = f"DEODR {importlib.metadata.version('deodr')}"
        self.render = differentiable_renderer.renderScene
        corners = clip[faces].reshape(-1, 4).astype(np.float64)
        count, num_faces = len(corners), len(faces)
        indices = np.arange(count, dtype=np.uint32).reshape(-1, 3)
        self.scene = differentiable_renderer.Scene2D(
            faces=indices,
            faces_uv=indices,
            # Row 0 is on top and a pixel's centre is at +0.5.
            ij=0.5 * size * (1.0 + np.array([1.0, -1.0]) * corners[:, :2] / corners[:, 3:]),
            depths=1.0 - corners[:, 2] / corners[:, 3],
            textured=np.zeros(num_faces, bool),
            uv=np.zeros((count, 2)),
            shade=np.zeros(count),
            colors=np.repeat(np.arange(1.0, num_faces + 1.0), 3)[:, None],
            shaded=np.zeros(num_faces, bool),
            edgeflags=np.zeros((num_faces, 3), bool),
            height=size,
            width=size,
            nb_colors=1,
            texture=np.zeros((0, 0, 0)),
            background_color=np.zeros(1),
            integer_pixel_centers=False,
        )
        self.image, self.depth = np.zeros((size, size, 1)), np.zeros((size, size))

    def draw(self) -> None:
        self.render(self.scene, 0.0, self.image, self.depth)

    def faces(self) -> np.ndarray:
        """Face id of every pixel, -1 for none, row 0 on top."""
        return np.rint(self.image[..., 0]).astype(np.int32) - 1

    def release(self) -> None:
        del self.scene
