"""What each effect of a frame costs: `python -m benchmarks.effects [SCENE ...] [--size PX] [--runs N]`.

A frame with all that the planner asks for, and frames that go without one effect each, take turns: the difference is
what the effect costs, in milliseconds, the fastest of several runs each. Beside it what the program takes longer to
compile, in seconds. Effects share work, so that the parts do not add up to the whole.
"""

import argparse
import time
import warnings
from dataclasses import replace

import jax

import jaxraster as jr
from jaxraster.plan import EFFECTS

from . import memory
from .measure import turns


def without(plan: jr.Plan) -> dict[str, jr.Plan]:
    """The plan, and what is left of it without each of its effects."""
    left = {name: replace(plan, **{name: None}) for name in EFFECTS if getattr(plan, name) is not None}
    if plan.texture_slots:
        left["textures"] = replace(plan, texture_slots=())
    if plan.light_kinds:
        left["punctual lights and shadows"] = replace(plan, light_kinds=(), shadow_map=None)
    return {"everything": plan, **left}


def compiled(scene: jr.Scene, camera: jr.Camera, plan: jr.Plan):
    """A call that draws, and the seconds that compiling it took."""
    began = time.perf_counter()
    draw = jax.jit(lambda *inputs: jr.render(*inputs).image).lower(scene, camera, plan).compile()
    seconds = time.perf_counter() - began
    return lambda: jax.block_until_ready(draw(scene, camera, plan)), seconds


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.effects", description=__doc__.splitlines()[0].split(":")[0]
    )
    parser.add_argument("scenes", nargs="*", default=["stage"], metavar="SCENE", help="built in, or a file")
    parser.add_argument("--environment", metavar="FILE", help="surroundings for the files among them")
    parser.add_argument("--size", type=int, default=512, metavar="PX", help="a side of the square pictures")
    parser.add_argument("--runs", type=int, default=7, metavar="N", help="the fastest of so many is quoted")
    options = parser.parse_args()
    memory.keep()
    for name in options.scenes:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            built_in = jr.scenes.SCENES.get(name)
            scene, camera = built_in() if built_in else jr.load(name, environment=options.environment)
        scene, camera = jax.device_put((scene, camera))
        plan, _ = jr.plan_for(scene, camera, width=options.size, height=options.size)
        calls = {left: compiled(scene, camera, one) for left, one in without(plan).items()}
        for call, _ in calls.values():
            call()
        times = turns({left: call for left, (call, _) in calls.items()}, options.runs)
        whole, seconds = times.pop("everything"), calls.pop("everything")[1]
        print(f"\n| {name} | ms | to compile, s |\n|---|--:|--:|\n| everything | {whole:.1f} | {seconds:.1f} |")
        for left, taken in times.items():
            print(f"| {left} | {whole - taken:.1f} | {seconds - calls[left][1]:.1f} |")


if __name__ == "__main__":
    main()
