"""The scene's lights with those that were cut out of its surroundings.

Gradient: exact in lights, suns and rotation.
"""

from dataclasses import replace

import jax.numpy as jnp

from ..environment.equirect import turned
from ..scene import Directional, Environment, Lights


def sunlit(lights: Lights, environment: Environment) -> Lights:
    """`lights` with the suns of the map, turned as it is, after the directional ones; as they are where it has none.

    Example:
        >>> from jaxraster.stack import stack_lights
        >>> nothing = Environment(up=jnp.array([0.0, 1.0, 0.0]), sky=jnp.zeros(3), ground=jnp.zeros(3))
        >>> lights = stack_lights()
        >>> sunlit(lights, nothing) is lights
        True
    """
    surroundings = environment.map
    if surroundings is None or surroundings.suns.direction.shape[-2] == 0:
        return lights
    suns, own = surroundings.suns, lights.directional
    # A batch may have rotations of its own, suns, or lights.
    around = [leaf.shape[:-2] for lights_of in (suns, own) for leaf in (lights_of.direction, lights_of.irradiance)]
    rotation = jnp.asarray(surroundings.rotation)
    lead, turn = jnp.broadcast_shapes(rotation.shape, *around), rotation[..., None]

    def join(first, second):
        parts = [jnp.broadcast_to(part, (*lead, *part.shape[-2:])) for part in (first, second)]
        return jnp.concatenate(parts, axis=-2)

    there = jnp.broadcast_to(suns.direction, (*lead, *suns.direction.shape[-2:]))
    direction = join(own.direction, turned(there, jnp.broadcast_to(turn, there.shape[:-1])))
    return replace(
        lights, directional=Directional(direction=direction, irradiance=join(own.irradiance, suns.irradiance))
    )
