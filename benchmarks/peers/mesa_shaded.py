"""A shaded frame by Mesa's llvmpipe: GGX over Lambert under one directional light with a shadow map, in GLSL.

The same surface model as `Plan.shading = "gltf"` and the same map as `ShadowMap()`: all of the scene in one projection,
3×3 comparisons about each place, weighed as a box. Linear light in 32-bit floats; nothing is read back while timing.
Needs the package moderngl and an EGL (Debian: libegl1, libgl1-mesa-dri).
"""

import numpy as np

import jaxraster as jr

MARGIN = 2  # texels left free around what is in the map

LIGHT_VERTEX = """
#version 330
uniform mat4 map_from_world;
in vec3 position;
void main() { gl_Position = map_from_world * vec4(position, 1.0); }
"""
LIGHT_FRAGMENT = "#version 330\nvoid main() {}"
VERTEX = """
#version 330
uniform mat4 clip_from_world;
in vec3 position, normal, color;
in vec2 surface;
out vec3 at, n, base;
out vec2 kind;
void main() {
    gl_Position = clip_from_world * vec4(position, 1.0);
    gl_Position.z = gl_Position.w - 2.0 * gl_Position.z;  // reversed depth to OpenGL's
    at = position; n = normal; base = color; kind = surface;
}
"""
FRAGMENT = """
#version 330
uniform mat4 map_from_world;
uniform sampler2DShadow map;
uniform vec3 eye, towards, irradiance;
uniform float texel, bias;
in vec3 at, n, base;
in vec2 kind;
out vec4 light;
const float PI = 3.14159265358979;

float lit(vec3 normal) {
    vec4 place = map_from_world * vec4(at, 1.0);
    vec3 p = 0.5 * place.xyz + 0.5;
    float cosine = max(abs(dot(normal, towards)), 1e-3);
    float nearer = p.z - bias * (0.5 + 2.0 * sqrt(1.0 - cosine * cosine) / cosine);
    float sum = 0.0;
    for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x)
            sum += texture(map, vec3(p.xy + texel * vec2(x, y), nearer));
    return sum / 9.0;
}

void main() {
    vec3 normal = normalize(n), v = normalize(eye - at), l = towards, h = normalize(v + l);
    if (dot(normal, v) < 0.0) normal = -normal;
    float nl = max(dot(normal, l), 0.0), nv = max(dot(normal, v), 1e-4), nh = dot(normal, h), vh = dot(v, h);
    float alpha = kind.y * kind.y, a2 = alpha * alpha;
    vec3 f0 = mix(vec3(0.04), base, kind.x), diffuse = base * (1.0 - kind.x);
    vec3 fresnel = f0 + (1.0 - f0) * pow(1.0 - clamp(vh, 0.0, 1.0), 5.0);
    float k = alpha / (1.0 - nh * nh + nh * nh * a2);
    float visible = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
    vec3 reflected = (1.0 - fresnel) * diffuse / PI + k * k / PI * visible * fresnel;
    light = vec4(reflected * nl * irradiance * lit(normal), 1.0);
}
"""


def _fitted(vertices: np.ndarray, direction: np.ndarray, size: int) -> tuple[np.ndarray, float]:
    """The map's projection of the world, and a texel's length in its depth."""
    towards = -direction / np.linalg.norm(direction)
    across = np.cross([0.0, 0.0, 1.0] if abs(towards[2]) < 0.9 else [1.0, 0.0, 0.0], towards)
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(towards, across), -towards])
    seen = vertices @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    extent = np.maximum(high - low, 1e-6)
    extent[:2] *= size / (size - 2 * MARGIN)
    extent[2] *= 1.01
    matrix = np.eye(4)
    matrix[:3, :3] = 2.0 * axes / extent[:, None]
    matrix[:3, 3] = -(high + low) / extent
    return matrix, float(extent[:2].max() / size / extent[2])


class MesaShaded:
    """A compiled frame of one scene, camera and size, under the scene's first directional light."""

    def __init__(self, scene: jr.Scene, camera: jr.Camera, size: int, resolution: int = 1024):
        import moderngl

        self.context = context = moderngl.create_context(standalone=True, backend="egl")
        mesh, materials = scene.mesh, scene.materials
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
        # Every vertex has the material of the last face that names it.
        row = np.zeros(len(vertices), np.int32)
        row[faces] = np.asarray(mesh.material)[:, None]
        kind = [np.asarray(v)[row] for v in (materials.base_color[:, :3], materials.metallic, materials.roughness)]
        columns = [vertices, mesh.normals, kind[0], kind[1][:, None], kind[2][:, None]]
        rows = context.buffer(np.concatenate([np.asarray(c, np.float32) for c in columns], axis=1).tobytes())
        index = context.buffer(faces.tobytes())
        self.light = context.program(vertex_shader=LIGHT_VERTEX, fragment_shader=LIGHT_FRAGMENT)
        self.shade = context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        self.casters = context.vertex_array(self.light, [(rows, "3f 32x", "position")], index)
        parts = [(rows, "3f 3f 3f 2f", "position", "normal", "color", "surface")]
        self.receivers = context.vertex_array(self.shade, parts, index)

        self.map = context.depth_texture((resolution, resolution))
        self.map.compare_func, self.map.filter = "<=", (moderngl.LINEAR, moderngl.LINEAR)
        self.map.repeat_x = self.map.repeat_y = False
        self.shadow = context.framebuffer([], self.map)
        self.colors = context.texture((size, size), 4, dtype="f4")
        self.target = context.framebuffer([self.colors], context.depth_texture((size, size)))
        context.enable_only(moderngl.DEPTH_TEST)

        lamp = scene.lights.directional
        direction = np.asarray(lamp.direction[0], np.float64)
        projection, texel = _fitted(vertices, direction, resolution)
        pose = np.asarray(camera.world_from_view, np.float64)
        for program in (self.light, self.shade):
            program["map_from_world"].write(projection.T.astype(np.float32).tobytes())
        world = np.asarray(camera.clip_from_view, np.float64) @ np.linalg.inv(pose)
        self.shade["clip_from_world"].write(world.T.astype(np.float32).tobytes())
        self.shade["eye"].value = tuple(pose[:3, 3])
        self.shade["towards"].value = tuple(-direction / np.linalg.norm(direction))
        self.shade["irradiance"].value = tuple(np.asarray(lamp.irradiance[0], np.float64))
        self.shade["texel"].value, self.shade["bias"].value = 1.0 / resolution, texel

    def draw(self) -> None:
        self.shadow.use()
        self.shadow.clear(depth=1.0)
        self.casters.render()
        self.target.use()
        self.target.clear(depth=1.0)
        self.map.use()
        self.receivers.render()
        self.context.finish()

    def picture(self) -> np.ndarray:
        """Linear light `[h, w, 3]`, row 0 on top."""
        size = self.colors.size[0]
        return np.frombuffer(self.colors.read(), np.float32).reshape(size, size, 4)[::-1, :, :3]

    def release(self) -> None:
        self.context.release()
