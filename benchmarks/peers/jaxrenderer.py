"""jaxrenderer: every pixel tests every triangle, in JAX; face id and depth.

Needs the package jaxrenderer, which needs Python 3.12. Its shaders are asked for flat ids of triangles of either side.
"""

import importlib.metadata

import numpy as np

from .clip import refuse_clipping

LARGEST = 2**29  # tests in a picture, about three seconds; a picture with more would hold up all others


class JaxRenderer:
    """A compiled frame of one workload and size."""

    def __init__(self, clip: np.ndarray, faces: np.ndarray, size: int):
        refuse_clipping(clip)
        if len(faces) * size**2 > LARGEST:
            raise ValueError(f"{len(faces):,} faces at {size}² pixels are over {LARGEST:,} tests")
        import jax
        import jax.numpy as jnp
        import renderer
        from renderer.pipeline import render
        from renderer.shader import PerVertex, Shader

        self.name, self.jax = f"jaxrenderer {importlib.metadata.version('jaxrenderer')}", jax

        class Ids(Shader):
            """Positions as they come, and one number of each triangle."""

            @staticmethod
            def vertex(gl_VertexID, gl_InstanceID, camera, extra):
                return PerVertex(gl_Position=extra[0][gl_VertexID]), (extra[1][gl_VertexID],)

            @staticmethod
            def primitive_chooser(gl_FragCoord, gl_FrontFacing, *others):
                return Shader.primitive_chooser(gl_FragCoord, jnp.ones_like(gl_FrontFacing), *others)

        def draw(corners, ids):
            indices = jnp.arange(len(corners)).reshape(-1, 3)
            # Its pixels' centres are at whole numbers, and its depth is OpenGL's.
            half, middle = size / 2, (size - 1) / 2
            viewport = jnp.array([[half, 0, 0, middle], [0, half, 0, middle], [0, 0, 0.5, 0.5], [0, 0, 0, 1]])
            camera = renderer.Camera.create(jnp.eye(4), jnp.eye(4), viewport)
            blank = jnp.full((size, size), jnp.inf)
            return render(camera, Ids, renderer.Buffers(blank, (jnp.full_like(blank, -1.0),)), indices, (corners, ids))

        corners = clip[faces].reshape(-1, 4)
        corners = np.stack([corners[:, 0], corners[:, 1], corners[:, 3] - 2 * corners[:, 2], corners[:, 3]], axis=-1)
        self.inputs = jnp.asarray(corners, jnp.float32), jnp.repeat(jnp.arange(len(faces), dtype=jnp.float32), 3)
        self.compiled = jax.jit(draw).lower(*self.inputs).compile()

    def draw(self) -> None:
        self.buffers = self.jax.block_until_ready(self.compiled(*self.inputs))

    def faces(self) -> np.ndarray:
        """Face id of every pixel, -1 for none, row 0 on top."""
        return np.rint(self.buffers.targets[0]).astype(np.int32).T[::-1]

    def release(self) -> None:
        del self.compiled, self.inputs
