"""The rasterizer beside others: `python -m benchmarks [--sizes 256,512,1024] [--helmet FILE] [--write | --gate]`.

From clip positions to face, barycentrics and depth: seconds to compile, milliseconds a picture, memory, and on how many
pixels the first peer present sees another face. docs/benchmarks.md says how, and what to install for which peer:

    pip install moderngl deodr mitsuba        # in a Python of the project's dependencies; Mesa's EGL and an LLVM beside
    pip install jaxrenderer                   # in a Python 3.12, to be named with --python312
"""

import argparse
import pathlib
import sys

import numpy as np

from . import gate, memory, report
from .measure import measure
from .peers import found
from .workloads import with_files


def _file(text: str) -> pathlib.Path:
    path = pathlib.Path(text).absolute()
    if not path.is_file():
        raise argparse.ArgumentTypeError(f"there is no file {text}")
    return path


def _sizes(text: str) -> list[int]:
    return [int(size) for size in text.split(",")]


def _command(options: argparse.Namespace) -> str:
    """What was asked for, with files by name alone."""
    words = {"sizes": ",".join(map(str, options.sizes)), "runs": str(options.runs)}
    words |= {name: path.name for name in ("helmet", "cornell", "python312") if (path := getattr(options, name))}
    return " ".join(["python -m benchmarks --write", *(f"--{name} {word}" for name, word in words.items())])


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.splitlines()[0].split(":")[0])
    add = parser.add_argument
    add("--sizes", type=_sizes, default=[256, 512, 1024], metavar="PX,...", help="sides of the square pictures")
    add("--runs", type=int, default=7, metavar="N", help="the fastest of so many is quoted")
    add("--helmet", type=_file, metavar="FILE", help="a large file of the field, as W4")
    add("--cornell", type=_file, metavar="FILE", help="a file for W5, the Cornell box")
    add("--python312", type=_file, metavar="PYTHON", help="for peers that this Python lacks")
    add = parser.add_mutually_exclusive_group().add_argument
    add("--write", action="store_true", help=f"replace the table in {report.PAGE.name}, and {gate.BASELINE.name}")
    add("--gate", action="store_true", help=f"exit with 1 if anything is worse than in {gate.BASELINE.name}")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, and write or compare; the exit code."""
    options = _options(arguments)
    kept = memory.keep()
    present, lines = found(options.python312)
    about = [report.machine(), f"freed memory {'stays with the process' if kept else 'may go back to the system'}"]
    about += [f"{name}: {'' if name in present else 'absent: '}{text}" for name, text in lines.items()]
    print("\n".join(about))
    peers, rows = list(present), []
    print(report.head(peers))
    for name, build in with_files(W4=options.helmet, W5=options.cornell).items():
        for size in options.sizes:
            rows.append(measure(name, build(size), size, present, options.runs))
            print(report.line(rows[-1], peers), flush=True)
    about.append(f"geometric mean of time over ours: {report.means(rows, peers) or 'no peer'}")
    about.append("calibration: {:.1f} to {:.1f} ms".format(*np.quantile([row.calibration for row in rows], (0, 1))))
    print("\n".join(about[-2:]))

    if options.write:
        report.write(rows, peers, [*about, f"`{_command(options)}`"])
        gate.write(rows)
    worse = gate.offenders(rows) if options.gate else []
    for text in worse:
        print(text)
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
