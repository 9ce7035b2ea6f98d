"""Each buffer of a frame as a picture to look at, and as channels of numbers.

Light and colours get the display's curve; data (normals, coordinates, roughness) are written as they are. Black is
nothing: no surface was seen there. Where some are seen through others, a buffer holds the foremost one's.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class AOV(NamedTuple):
    """`pick(frame, camera, plan)` names a buffer of a frame, under jit; `show(mask, values, plan)` makes a picture of
    it on the host, [h w 3] in [0, 1], and a remark on its scale. `channels` has a letter for each of its numbers."""

    pick: Callable[..., Any]
    show: Callable[..., tuple[np.ndarray, str]]
    channels: str


def finite_pixels(image) -> tuple[np.ndarray, int]:
    """The image with its non-finite pixels black, and how many those were."""
    image = np.asarray(image)
    good = np.all(np.isfinite(image), axis=-1, keepdims=True)
    return np.where(good, image, 0.0), int(np.sum(~good))


def _surface(name: str):
    """Pick a field of the surface."""
    return lambda frame, camera, plan: getattr(frame.surface, name)


def _visibility(name: str):
    """Pick a field of the visibility."""
    return lambda frame, camera, plan: getattr(frame.visibility, name)


def _distance(frame, camera, plan):
    """Pick the metres in front of the camera, along its axis."""
    import jax.numpy as jnp

    from ..math.safe import dot

    position = frame.surface.position
    pose = jnp.broadcast_to(camera.world_from_view[:3], (*position.shape, 4))
    return dot(pose[..., 3] - position, pose[..., 2])


def _light(name: str):
    """Pick one path of the light."""
    return lambda frame, camera, plan: getattr(frame.radiance, name)


def _picture(mask: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Clip to [0, 1], black where nothing is; one channel becomes grey, two red and green."""
    image, _ = finite_pixels(np.where(mask[..., None], values, 0.0))
    missing = 3 - image.shape[-1]
    image = np.pad(image, ((0, 0), (0, 0), (0, missing)), mode="edge" if missing == 2 else "constant")
    return np.clip(image, 0.0, 1.0)


def _codes(mask, values, plan):
    """Show data in [0, 1] unchanged."""
    return _picture(mask, values), "data in [0, 1], no curve"


def _shown(mask, values, plan):
    """Show light as the image is displayed."""
    import jax.numpy as jnp

    from ..display.exposure import exposure
    from ..display.tonemap import tonemap
    from ..display.transfer import srgb_encode

    image = srgb_encode(tonemap(exposure(jnp.asarray(values), plan.exposure), plan.tonemap))
    return _picture(mask, np.asarray(image)), "displayed as the image is"


def _colour(mask, values, plan):
    """Show linear light through the sRGB curve alone."""
    import jax.numpy as jnp

    from ..display.transfer import srgb_encode

    return np.asarray(srgb_encode(jnp.asarray(_picture(mask, values)))), "linear colour through the sRGB curve"


def _units(mask, values, plan):
    """Show directions: 0.5 + 0.5 n."""
    return _picture(mask, 0.5 + 0.5 * values), "0.5 + 0.5 n in world space, no curve"


def _fraction(mask, values, plan):
    """Show coordinates modulo 1."""
    return _picture(mask, values % 1.0), "the fractions of u and v, no curve"


def _roughness(mask, values, plan):
    """Show the perceptual roughness, √alpha."""
    return _picture(mask, np.sqrt(values)), "perceptual roughness, no curve"


def _hashed(mask, values, plan):
    """Show numbers as colours, far apart for neighbours: fractions of multiples of 1/g, 1/g², 1/g³ with g⁴ = g + 1.

    Source: Roberts 2018, "The Unreasonable Effectiveness of Quasirandom Sequences".
    """
    steps = np.array([0.8191725134, 0.6710436067, 0.5497004779])
    return _picture(mask, 0.25 + 0.75 * (values * steps % 1.0)), f"{len(np.unique(values[mask]))} faces"


def _scaled(least: float, greatest: float, words: str):
    """Show values with their least drawn as the code `least` and their greatest as `greatest`, and tell both."""

    def show(mask, values, plan):
        seen = values[mask & np.isfinite(values).all(axis=-1)]
        low, high = (seen.min(0), seen.max(0)) if len(seen) else (np.zeros(values.shape[-1]),) * 2
        size = np.where(high > low, high - low, 1.0)
        low_text, high_text = (" ".join(f"{x:.4g}" for x in v) for v in (low, high))
        return _picture(
            mask, least + (greatest - least) * (values - low) / size
        ), f"{low_text} to {high_text} m, {words}"

    return show


AOVS: dict[str, AOV] = {
    "depth": AOV(_distance, _scaled(1.0, 0.1, "white to dark"), "Z"),
    "normal": AOV(_surface("normal"), _units, "XYZ"),
    "geometric_normal": AOV(_surface("geometric_normal"), _units, "XYZ"),
    "face": AOV(_visibility("face"), _hashed, "Y"),
    "barycentric": AOV(_visibility("barycentric"), _codes, "UVW"),
    "uv": AOV(_surface("uv"), _fraction, "UV"),
    "position": AOV(_surface("position"), _scaled(0.0, 1.0, "black to white"), "XYZ"),
    "diffuse_color": AOV(_surface("diffuse_color"), _colour, "RGB"),
    "f0": AOV(_surface("f0"), _colour, "RGB"),
    "f90": AOV(_surface("f90"), _codes, "Y"),
    "roughness": AOV(_surface("alpha"), _roughness, "Y"),
    "occlusion": AOV(_surface("occlusion"), _codes, "Y"),
    "emissive": AOV(_surface("emissive"), _colour, "RGB"),
    "direct_diffuse": AOV(_light("direct_diffuse"), _shown, "RGB"),
    "direct_specular": AOV(_light("direct_specular"), _shown, "RGB"),
    "indirect_diffuse": AOV(_light("indirect_diffuse"), _shown, "RGB"),
    "indirect_specular": AOV(_light("indirect_specular"), _shown, "RGB"),
    "emitted": AOV(_light("emitted"), _shown, "RGB"),
}


def pick(name: str, frame, camera, plan):
    """A buffer [h w c] and where it is seen: of plan.supersample² samples per pixel, the one in the middle."""
    n = plan.supersample
    buffer = AOVS[name].pick(frame, camera, plan)
    buffer = buffer if buffer.ndim == 3 else buffer[..., None]
    return frame.surface.mask[n // 2 :: n, n // 2 :: n], buffer[n // 2 :: n, n // 2 :: n]


def picture(name: str, mask, buffer, plan) -> tuple[np.ndarray, str]:
    """A picked buffer as [h w 3] in [0, 1], and a remark on its scale."""
    return AOVS[name].show(np.asarray(mask), np.asarray(buffer), plan)


def channels(name: str, mask, buffer) -> dict[str, np.ndarray]:
    """A picked buffer as named float channels, `normal.X` and so on; 0 where nothing is, -1 for faces.

    Face ids are exact up to 2²⁴.
    """
    values = np.asarray(buffer).astype(np.float32)
    values = values if name == "face" else np.where(np.asarray(mask)[..., None], values, np.float32(0))
    return {f"{name}.{letter}": values[..., i] for i, letter in enumerate(AOVS[name].channels)}
