"""The command line `iga`: build, inspect, refine, solve, study, measure and draw solids.

Answers go to standard output (one JSON object with ``--json``), progress and errors to standard error. Exit status 0:
done; 1: a check failed or a solve did not converge; 2: bad input.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from iga.errors import ConvergenceError, InputError
from iga.parallel import threads
from iga.progress import choosing
from studies import commands
from studies.commands import Answer


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    options = _parser().parse_args(arguments)
    try:
        with choosing("none" if options.quiet else "auto"):
            answer = options.run(options)
        status = int(answer.pop("exit", 0))
        if options.json:
            print(json.dumps(_finite(answer), default=_plain, allow_nan=False))
        else:
            options.show(answer)
        sys.stdout.flush()
    except InputError as error:
        return _fail(str(error), 2)
    except ConvergenceError as error:
        return _fail(str(error), 1)
    except MemoryError:
        return _fail("there is not enough memory for this", 1)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except BrokenPipeError:
        # The reader has gone; what is left in the buffer must not be written at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return status


def _direction(text: str) -> list[float]:
    """Three numbers of the command line, "1,-2,0.5"."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"three numbers as 1,-2,0.5 are needed, not {text!r}")
    return numbers


def _fail(message: str, status: int) -> int:
    print("iga: " + " ".join(message.split()), file=sys.stderr)
    return status


def _plain(value: Any) -> Any:
    """NumPy numbers and arrays, and paths, for JSON."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _finite(value: Any) -> Any:
    """NaN and infinity are no JSON: None instead."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# --- what a person sees -----------------------------------------------------------------------------------------------


def _show(answer: Answer, indent: str = "") -> None:
    """Keys and values, nested ones indented."""
    for key, value in answer.items():
        if isinstance(value, dict):
            print(f"{indent}{key}:")
            _show(value, indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            print(f"{indent}{key}:")
            _show_table(value, indent + "  ")
        else:
            print(f"{indent}{key}: {_short(value)}")


def _show_table(rows: list[Answer], indent: str) -> None:
    """Rows below the names of their columns; a row may lack some."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [names, *([_short(row[name]) if name in row else "" for name in names] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines)]
    for line in lines:
        print(indent + "  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip())


def _show_pairs(rows: list[Answer]) -> None:
    """Names and what is said of them."""
    for name, about in map(dict.values, rows):
        print(f"{name:<28} {about}")


def _short(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, list):
        return ", ".join(map(_short, value)) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _shown(answer: Answer) -> None:
    """The command has printed what there is to see."""


# --- arguments --------------------------------------------------------------------------------------------------------

_EXAMPLES = """\
examples:
  iga build sphere.msh --source tets --set convert=hex4 -o sphere.npz     curved tets to Bezier hexahedra
  iga info sphere.npz                                                     what is in it, and is it valid
  iga solve sphere.npz --heat --exact "sin(2*x)*cos(y)" -o heat.vtu       manufactured solution, with errors
  iga solve sphere.npz problem.toml -o heat.vtu                           a problem of your own
  iga plot heat.vtu --field temperature -o heat.png
  iga study list                                                          questions answered with tables
"""


class _Version(argparse.Action):
    """Print the version; it is looked up only then, because that takes as long as all else at the start."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print("iga", version("solids-iga"))
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="iga", formatter_class=argparse.RawDescriptionHelpFormatter, epilog=_EXAMPLES,
        description="Isogeometric analysis on solids that come from anywhere.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    top = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    build = _command(
        top, "build", commands.build,
        "turn a file into a domain: spline space, control points, named boundaries, validity proof",
        "`iga sources` lists the sources, `iga sources NAME` explains inputs and settings of one. Where no file has\n"
        "the name, INPUT may be a built-in shape, such as thick_ring, cylinder or ball.",
    )
    build.add_argument("input", metavar="INPUT", help="mesh, spline or CAD file, or the name of a built-in shape")
    build.add_argument("--source", metavar="NAME", help="geometry source; by default the first that reads the file")
    build.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="setting of the source")
    build.add_argument("-o", "--output", required=True, metavar="DOMAIN.npz", help="file to write")

    info = _command(top, "info", commands.info, "describe a saved domain")
    info.add_argument("domain", metavar="DOMAIN.npz", help="as `iga build` writes it")

    refine = _command(top, "refine", commands.refine, "refine a domain without changing its shape")
    refine.add_argument("domain", metavar="DOMAIN.npz", help="as `iga build` writes it")
    refine.add_argument(
        "--levels", type=int, metavar="N", help="halve every element N times (default 1, or 0 with --elevate)"
    )
    refine.add_argument("--elevate", type=int, default=0, metavar="P", help="raise the degree by P first (default 0)")
    refine.add_argument("-o", "--output", required=True, metavar="OUT.npz", help="file to write; may be the input")

    solve = _command(
        top, "solve", commands.solve, "solve heat conduction or elasticity on a domain",
        'With --exact, a formula in x, y, z ("u;v;w" for elasticity), all data follow from it by exact\n'
        "differentiation and the errors are reported. A PROBLEM.toml names material, loads and one condition for\n"
        "each boundary name or pattern; problems/examples has commented ones.\n\n"
        "The answer's extrema are those at the Gauss points, which lie inside the elements: a stress that is largest\n"
        "on the boundary is larger in the picture. Reactions are what each held boundary takes up.",
    )
    solve.add_argument("domain", metavar="DOMAIN.npz", help="as `iga build` writes it; `iga info` lists its boundaries")
    solve.add_argument("problem", nargs="?", metavar="PROBLEM.toml", help="problem file")
    physics = solve.add_mutually_exclusive_group()
    physics.add_argument("--heat", dest="physics", action="store_const", const="heat", help="heat conduction, k = 1")
    physics.add_argument(
        "--elasticity", dest="physics", action="store_const", const="elasticity",
        help="linear elasticity, E = 1, nu = 0.3",
    )
    solve.add_argument("--exact", metavar="EXPR", help="exact solution that makes the data")
    solve.add_argument(
        "--solver", choices=("auto", "direct", "cg", "matrix-free"),
        help="linear solver (default auto; matrix-free for elasticity only)",
    )
    about = "Gauss points per direction (default: degree + 1, or what the patch test needs)"
    solve.add_argument("--quadrature", type=int, metavar="N", help=about)
    solve.add_argument("--allow-invalid", action="store_true", help="solve even on a domain with folded elements")
    solve.add_argument("-o", "--output", metavar="OUT.vtu", help="Bezier cells with geometry and fields, for ParaView")

    _study(top.add_parser("study", help="list, run or check the studies", description=_STUDIES))
    _bench(top.add_parser("bench", help="measure a standard problem", description="Measure a standard problem."))

    plot = _command(top, "plot", commands.plot, "draw a domain or a solution into an image")
    plot.add_argument("file", metavar="FILE", help="DOMAIN.npz or OUT.vtu")
    plot.add_argument("--field", metavar="F", help="field to colour by")
    plot.add_argument("--cut", metavar="AXIS", help="cut the solid open: x, -x, y, -y, z or -z")
    about = "direction from the solid to the eye (default: oblique); --view=-1,0,0 where it begins with a minus"
    plot.add_argument("--view", metavar="X,Y,Z", type=_direction, help=about)
    plot.add_argument("--up", choices=("x", "y", "z"), default="z", help="axis that points up (default z)")
    plot.add_argument("-o", "--output", required=True, metavar="PNG", help="image to write")

    export = _command(top, "export", commands.export, "write a domain for other programs")
    export.add_argument("domain", metavar="DOMAIN.npz", help="as `iga build` writes it")
    export.add_argument("-o", "--output", required=True, metavar="FILE", help=".vtu, .vtk, .xml (G+Smo) or .bext")

    sources = _command(top, "sources", commands.sources, "list the geometry sources, or say all about one")
    sources.add_argument("name", nargs="?", metavar="NAME", help="source whose inputs and settings to explain")
    sources.set_defaults(show=lambda a: print(a["about"]) if "about" in a else _show_pairs(a["sources"]))

    demo = _command(top, "demo", commands.demo, "a tour in three minutes: tables, plots and pictures")
    demo.add_argument("--out", default="results/demo", metavar="DIR", help="folder to write (default results/demo)")
    demo.set_defaults(show=_shown)
    return parser


_STUDIES = "A study is a question with a table for an answer; its baseline holds the table fast."


def _study(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    names = _command(actions, "list", commands.study_list, "names and questions of all studies")
    names.set_defaults(show=lambda a: _show_pairs(a["studies"]))
    run = _command(actions, "run", commands.study_run, "run studies, write tables (CSV, JSON) and figures (PNG)")
    run.add_argument("names", nargs="+", metavar="NAME", help="studies, as `iga study list` names them")
    run.add_argument("--size", choices=("ci", "full"), default="full", help="seconds or minutes (default full)")
    run.add_argument("--out", default="results", metavar="DIR", help="folder to write (default results)")
    check = _command(actions, "check", commands.study_check, "compare studies at size ci with their baselines")
    check.add_argument("names", nargs="*", metavar="NAME", help="studies; all if none is named")
    for made in (run, check):
        made.set_defaults(show=_shown)


def _bench(parser: argparse.ArgumentParser) -> None:
    cases = parser.add_subparsers(title="benchmarks", metavar="BENCHMARK", required=True)
    cube = _command(
        cases, "cube", commands.bench_cube, "assembly and solution on the unit cube with a curved interior map"
    )
    cube.add_argument("--problem", choices=("heat", "elasticity"), default="heat", help="equation (default heat)")
    cube.add_argument("--degree", type=int, default=3, metavar="P", help="of the splines (default 3)")
    cube.add_argument("--elements", type=int, default=16, metavar="N", help="in each direction (default 16)")
    cube.add_argument("--matrix-free", action="store_true", help="apply the operator without assembling it")
    hexes = _command(
        cases, "catmull_clark", commands.bench_catmull_clark, "from hexahedra to interpolating control points"
    )
    hexes.add_argument("--elements", type=int, default=100_000, metavar="N", help="hexahedra (default 100000)")
    hexes.add_argument("--mesh", metavar="FILE", help="a mesh of hexahedra to take instead")
    hexes.add_argument("--stiffness", action="store_true", help="go on to the stiffness matrix")
    for made in (cube, hexes):
        made.add_argument(
            "--threads", type=int, default=threads(), metavar="T", help="(default: all that this process may use)"
        )


def _command(
    parent: Any, name: str, run: Callable[[argparse.Namespace], Answer], text: str, epilog: str = ""
) -> argparse.ArgumentParser:
    """A command with its help and the options that all have; ``parent`` is what argparse's add_subparsers returns."""
    made: argparse.ArgumentParser = parent.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + ".", epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("--json", action="store_true", help="print exactly one JSON object on standard output")
    made.add_argument("--quiet", action="store_true", help="no progress on standard error")
    made.set_defaults(run=run, show=_show)
    return made


if __name__ == "__main__":
    sys.exit(main())
