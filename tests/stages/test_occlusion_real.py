"""Ambient occlusion on the screen against rays, on whole scenes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxraster as jr
from benchmarks import occlusion

SIZE, RAYS = 256, 64  # of every second pixel of every second line
OFF = 0.05  # the mean difference that the default setting may have


@pytest.mark.parametrize("name", ["stage", "FlightHelmet"])
@pytest.mark.filterwarnings("ignore:.*FlightHelmet")
def test_the_default_is_near_what_rays_find(name, request):
    """Nearer than the classic, which is nearer than no occlusion."""
    if name == "stage":
        scene, camera = jr.scenes.stage()
    else:
        scene, camera = jr.load(request.getfixturevalue("assets") / name / f"{name}.gltf")
    visibility, surface = occlusion.seen(scene, camera, SIZE)
    tree = jr.build(scene.mesh.vertices, scene.mesh.faces)
    rays = jax.jit(lambda *parts: occlusion.traced(*parts, radius=jr.HorizonAO().radius, rays=RAYS))
    fourth = jax.tree.map(lambda part: part[::2, ::2] if part.ndim > 1 else part, (visibility, surface))
    exact, mask = np.asarray(rays(scene, tree, *fourth)), np.asarray(surface.mask)[::2, ::2]

    def error(found):
        return np.abs(np.asarray(found)[::2, ::2] - exact)[mask].mean()

    horizon, ssao = (
        error(occlusion.METHODS[type(settings)](surface, camera, settings).visibility)
        for settings in (jr.HorizonAO(), jr.SSAO())
    )
    none = error(jnp.ones(surface.mask.shape))
    print(f"{name}: {horizon:.4f} by horizons, {ssao:.4f} by points, {none:.4f} by none")
    assert horizon < OFF and horizon < ssao < none
