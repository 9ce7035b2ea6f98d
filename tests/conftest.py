"""One strict session for all tests: no silent promotion of dtype or rank, warnings are errors, shapes are checked."""

import os
import pathlib

import jax
import pytest

# Each of the parallel workers takes one core: two pools of threads on two cores would only wait for each other.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_platforms", os.environ.get("JAX_PLATFORMS", "cpu"))

ASSETS = pathlib.Path(os.environ.get("JAXRASTER_ASSETS", pathlib.Path(__file__).parents[2] / "shared" / "assets"))


@pytest.fixture(scope="session")
def assets() -> pathlib.Path:
    """Real models for tests; they are not part of the project, so tests that need them skip where they are absent."""
    if not ASSETS.is_dir():
        pytest.skip(f"no folder of real models at {ASSETS} (set JAXRASTER_ASSETS)")
    return ASSETS
