"""Surroundings from files: pictures of all directions, prepared to light a scene."""

import os
import pathlib
import warnings
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..environment.prepare import prepare
from ..environment.sun import cut_suns
from ..errors import AssetWarning, InputError, UsageError
from ..scene import Directional, Environment, EnvironmentMap
from .asset import floats
from .cache import cached_path, fetch, store
from .disk import Path, read_file
from .light import read_light
from .reading import DEFAULT, Limits

Surroundings = Path | Iterable | EnvironmentMap | Environment
PARTS = ("texels", "harmonics", "irradiance", "specular")


class Prepared(NamedTuple):
    """Where a prepared map was put, how many bytes it takes there, and the map."""

    path: str
    size: int
    map: EnvironmentMap


def _prepare(path: Path, suns: bool, limits: Limits) -> tuple[EnvironmentMap, tuple[str, ...]]:
    """The map of a picture, and what was put right in it."""
    texels, notes = read_light(path, limits)
    height, width, _ = texels.shape
    if width != 2 * height and (height, width) != (1, 1):
        what = f"has {width} x {height} pixels, but all directions make a picture twice as wide as high"
        raise InputError(path, "", f"{what}; convert it to equirectangular projection")
    texels, cut = cut_suns(texels) if suns else (texels, None)
    return prepare(jnp.asarray(texels), cut), notes


def _from_cache(path: Path, where: pathlib.Path, limits: Limits) -> tuple[EnvironmentMap, tuple[str, ...]] | None:
    """What `prepare_environment` has put there; None where it has not, or where it is damaged, with a warning."""
    try:
        arrays = fetch(where)
        if arrays is None:
            return None
        texels = arrays["texels"]
        if texels.shape[0] * texels.shape[1] > limits.light_pixels or max(texels.shape) > limits.light_side:
            return None
        suns = Directional(direction=jnp.asarray(arrays["direction"]), irradiance=jnp.asarray(arrays["radiant"]))
        parts = {name: jnp.asarray(arrays[name]) for name in PARTS}
        return EnvironmentMap(rotation=jnp.zeros(()), suns=suns, **parts), tuple(arrays["notes"].tolist())
    except (ValueError, KeyError, IndexError) as error:
        what = f"{path}: its prepared form {where} is damaged ({error}); prepare it again"
        warnings.warn(what, AssetWarning, stacklevel=4)
        return None


def read_environment(
    path: Path, *, suns: bool = True, rotation: float = 0.0, cache: bool = True, limits: Limits = DEFAULT
) -> EnvironmentMap:
    """A picture of all directions in equirectangular projection (.hdr, .pic, .exr), prepared to light a scene.

    `suns` cuts small strong lights out of it, to cast shadows (see `environment.sun`); `rotation` (rad) turns it about
    +Y. With `cache` what `prepare_environment` or `jaxraster prepare` has left for this very file is used.

    A picture that is not twice as wide as high is an `InputError`, but for a single pixel, which is light from all
    around. Texels that are not finite or negative become 0, with an `AssetWarning` that counts them.
    """
    where = cached_path(read_file(path, limits), suns) if cache else None
    found = _from_cache(path, where, limits) if where else None
    surroundings, notes = found or _prepare(path, suns, limits)
    for note in notes:
        warnings.warn(f"{os.fspath(path)}: {note}", AssetWarning, stacklevel=2)
    return replace(surroundings, rotation=jnp.asarray(rotation, surroundings.texels.dtype))


def prepare_environment(path: Path, *, suns: bool = True, limits: Limits = DEFAULT) -> Prepared:
    """Prepare a picture of all directions and keep the result where `read_environment` finds it."""
    where = cached_path(read_file(path, limits), suns)
    surroundings, notes = _prepare(path, suns, limits)
    for note in notes:
        warnings.warn(f"{os.fspath(path)}: {note}", AssetWarning, stacklevel=2)
    arrays = {name: getattr(surroundings, name) for name in PARTS}
    arrays |= {"direction": surroundings.suns.direction, "radiant": surroundings.suns.irradiance}
    host = jax.tree.map(np.asarray, arrays) | {"notes": np.array(notes, np.str_)}
    return Prepared(os.fspath(where), store(where, host), surroundings)


def surroundings(given: Surroundings, limits: Limits = DEFAULT) -> Environment:
    """The environment that a path, a colour, a map or an environment stands for."""
    if isinstance(given, Environment):
        return given
    up, black = floats((0.0, 1.0, 0.0), 3), floats((0.0, 0.0, 0.0), 3)
    if isinstance(given, str | os.PathLike):
        given = read_environment(given, limits=limits)
    if isinstance(given, EnvironmentMap):
        return Environment(up=up, sky=black, ground=black, map=given)
    try:
        color = np.asarray(given, np.float32)
    except (TypeError, ValueError):
        color = np.zeros(0)
    if color.shape != (3,) or not (np.isfinite(color) & (color >= 0)).all():
        wanted = "a path, three numbers of at least 0, an EnvironmentMap or an Environment"
        raise UsageError(None, "environment", f"expected {wanted}, got {given!r:.60}")
    return Environment(up=up, sky=floats(color, 3), ground=floats(color, 3))
