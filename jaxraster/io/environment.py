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
from jaxtyping import Float

from ..environment.prepare import prepare
from ..environment.sky import Number, Vector, sky
from ..environment.sun import cut_suns
from ..errors import AssetWarning, InputError, UsageError
from ..scene import Directional, Environment, EnvironmentMap, check_map
from .asset import LARGEST, floats
from .cache import cached_path, fetch, store
from .disk import Path, read_file, suffix_of
from .light import check_light, decode_light
from .reading import DEFAULT, Limits

Surroundings = Path | float | Iterable | EnvironmentMap | Environment
PARTS = ("texels", "harmonics", "irradiance", "specular")
SKY = "sky"  # the name of what `clear_sky` makes
TOWARDS_SUN = (0.4, 0.6, 0.7)  # 37° high, before the left shoulder of who looks along -Z
TURBIDITY = 3.0
SKY_GAIN = 3e-5  # a sun of 90 klx becomes one of some 3, as the lamp of files that bring none
SKY_ROWS = 256  # of texels: 0.7° each, finer than the model's features


class Prepared(NamedTuple):
    """Where a prepared map was put, how many bytes it takes there, and the map."""

    path: str
    size: int
    map: EnvironmentMap


def _prepare(
    data: bytes, path: Path, suns: bool, strict: bool, limits: Limits
) -> tuple[EnvironmentMap, tuple[str, ...]]:
    """The map of a picture, from the bytes of its file, and what was put right in it."""
    texels, notes = decode_light(data, path, limits, strict=strict)
    height, width, _ = texels.shape
    if width != 2 * height and (height, width) != (1, 1):
        what = f"has {width} x {height} pixels, but all directions make a picture twice as wide as high"
        raise InputError(path, "", f"{what}; convert it to equirectangular projection")
    texels, cut = cut_suns(texels) if suns else (texels, None)
    return prepare(jnp.asarray(texels), cut), notes


def _kept(where: pathlib.Path, limits: Limits, strict: bool) -> tuple[EnvironmentMap | None, tuple[str, ...]]:
    """What `prepare_environment` has put there, and notes; None where it has not, or where it is damaged."""
    try:
        arrays = fetch(where)
        if arrays is None:
            return None, ()
        suns = Directional(direction=jnp.asarray(arrays["direction"]), irradiance=jnp.asarray(arrays["radiant"]))
        parts = {name: jnp.asarray(arrays[name]) for name in PARTS}
        surroundings = EnvironmentMap(rotation=jnp.zeros(()), suns=suns, **parts)
        check_map("map", surroundings)
        notes = tuple(arrays["notes"].tolist())
    except (KeyError, TypeError, ValueError) as error:
        return None, (f"its prepared form {where} is damaged ({error}); prepare it again",)
    height, width, _ = surroundings.texels.shape
    large = height * width > limits.light_pixels or max(height, width) > limits.light_side
    # Let who reads the picture itself say what is too large, or what was put right and must not be.
    return (None, ()) if large or (strict and notes) else (surroundings, notes)


def _read(path: Path, suns: bool, cache: bool, strict: bool, limits: Limits) -> tuple[EnvironmentMap, tuple[str, ...]]:
    """The map of a picture, prepared now or before, and notes on it, which begin with the path."""
    check_light(path)
    data = read_file(path, limits)
    made, notes = _kept(cached_path(data, suffix_of(path), suns), limits, strict) if cache else (None, ())
    if made is None:
        made, more = _prepare(data, path, suns, strict, limits)
        notes += more
    return made, tuple(f"{os.fspath(path)}: {note}" for note in notes)


def read_environment(
    path: Path,
    *,
    suns: bool = True,
    rotation: float = 0.0,
    cache: bool = True,
    strict: bool = False,
    limits: Limits = DEFAULT,
) -> EnvironmentMap:
    """A picture of all directions in equirectangular projection (.hdr, .pic, .exr), prepared to light a scene.

    `suns` cuts small strong lights out of it, to cast shadows (see `environment.sun`); `rotation` (rad) turns it about
    +Y. With `cache` what `prepare_environment` or `jaxraster prepare` has left for this very file is used.

    A picture that is not twice as wide as high is an `InputError`, but for a single pixel, which is light from all
    around. Texels that are not finite or negative become 0, with an `AssetWarning` that counts them, or an `InputError`
    where `strict`.
    """
    read, notes = _read(path, suns, cache, strict, limits)
    for note in notes:
        warnings.warn(note, AssetWarning, stacklevel=2)
    return replace(read, rotation=jnp.asarray(rotation, read.texels.dtype))


def prepare_environment(path: Path, *, suns: bool = True, strict: bool = False, limits: Limits = DEFAULT) -> Prepared:
    """Prepare a picture of all directions and keep the result where `read_environment` finds it."""
    check_light(path)
    data = read_file(path, limits)
    made, notes = _prepare(data, path, suns, strict, limits)
    for note in notes:
        warnings.warn(f"{os.fspath(path)}: {note}", AssetWarning, stacklevel=2)
    arrays = {name: getattr(made, name) for name in PARTS}
    arrays |= {"direction": made.suns.direction, "radiant": made.suns.irradiance}
    host = jax.tree.map(np.asarray, arrays) | {"notes": np.array(notes, np.str_)}
    where = cached_path(data, suffix_of(path), suns)
    return Prepared(os.fspath(where), store(where, host), made)


def clear_sky(
    towards_sun: Vector = TOWARDS_SUN, turbidity: Number = TURBIDITY, *, rotation: float = 0.0
) -> EnvironmentMap:
    """The sky and sun of `environment.sky`, as bright as needs no exposure."""
    return prepare(*sky(towards_sun, turbidity, height=SKY_ROWS, width=2 * SKY_ROWS, gain=SKY_GAIN), rotation)


def _tones(given: float | Iterable) -> Float[np.ndarray, "2 3"]:
    """Radiance of the sky and of the ground: the same for a grey or a colour, a row each for two of them."""
    try:
        tones = np.broadcast_to(np.asarray(given), (2, 3))
    except (TypeError, ValueError):
        tones = np.full((2, 3), np.nan)
    if tones.dtype.kind not in "fiu" or not ((tones >= 0) & (tones <= LARGEST)).all():
        numbers = f"a grey, a colour or two of them, from 0 to {LARGEST:g}"
        wanted = f"a path, {SKY!r}, {numbers}, an EnvironmentMap or an Environment"
        raise UsageError(None, "environment", f"expected {wanted}, got {given!r:.60}")
    return tones.astype(np.float32)


def surroundings(
    given: Surroundings, *, strict: bool = False, limits: Limits = DEFAULT
) -> tuple[Environment, tuple[str, ...]]:
    """The environment that is given, or what lies around by a path, a name, tones or a map; and notes on a file."""
    if isinstance(given, Environment):
        return given, ()
    notes: tuple[str, ...] = ()
    if isinstance(given, str) and given == SKY:
        given = clear_sky()
    elif isinstance(given, str | os.PathLike):
        given, notes = _read(given, True, True, strict, limits)
    up = floats((0.0, 1.0, 0.0), 3)
    if isinstance(given, EnvironmentMap):
        return Environment(up=up, sky=jnp.zeros(3), ground=jnp.zeros(3), map=given), notes
    sky_tone, ground = _tones(given)
    return Environment(up=up, sky=floats(sky_tone, 3), ground=floats(ground, 3)), notes
