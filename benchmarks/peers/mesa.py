"""Mesa's llvmpipe through EGL: face id, barycentrics and depth of clip positions, with all buffers resident.

Needs the package moderngl and an EGL (Debian: libegl1, libgl1-mesa-dri). Reversed depth d = z/w becomes OpenGL's
1 - 2d; nothing is read back while timing, and glFinish ends a frame.
"""

import numpy as np

VERTEX = """
#version 330
in vec4 clip;
out vec2 corner;
void main() {
    gl_Position = vec4(clip.xy, clip.w - 2.0 * clip.z, clip.w);
    int i = gl_VertexID % 3;
    corner = vec2(i == 1, i == 2);
}
"""
FRAGMENT = """
#version 330
in vec2 corner;
layout(location = 0) out int id;
layout(location = 1) out vec2 barycentric;
void main() {
    id = gl_PrimitiveID + 1;
    barycentric = corner;
}
"""


class Mesa:
    """A compiled frame of one workload and size."""

    def __init__(self, clip: np.ndarray, faces: np.ndarray, size: int):
        import moderngl

        self.context = moderngl.create_context(standalone=True, backend="egl")
        self.name = self.context.info["GL_RENDERER"] + ", " + self.context.info["GL_VERSION"]
        program = self.context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        # Corners one after the other, so that each knows which of its triangle it is.
        corners = self.context.buffer(np.ascontiguousarray(clip[faces].reshape(-1, 4), np.float32).tobytes())
        self.triangles = self.context.vertex_array(program, [(corners, "4f", "clip")])
        self.ids = self.context.texture((size, size), 1, dtype="i4")
        self.corner = self.context.texture((size, size), 2, dtype="f4")
        depth = self.context.depth_texture((size, size))
        self.target = self.context.framebuffer([self.ids, self.corner], depth)
        self.target.use()
        self.context.enable_only(moderngl.DEPTH_TEST)
        self.context.depth_func = "<"

    def draw(self) -> None:
        self.target.clear(depth=1.0)
        self.triangles.render()
        self.context.finish()

    def faces(self) -> np.ndarray:
        """Face id of every pixel, -1 for none, row 0 on top."""
        size = self.ids.size[0]
        return np.frombuffer(self.ids.read(), np.int32).reshape(size, size)[::-1] - 1

    def release(self) -> None:
        self.context.release()
