"""The command line `iga`: build, inspect, refine, solve, study, measure and draw solids.

Answers go to standard output (one JSON object with ``--json``), progress and errors to standard error. Exit status 0:
done; 1: a check failed or a solve did not converge; 2: bad input.
"""

from __future__ import annotations

import argparse
import inspect
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from iga.errors import ConvergenceError, InputError
from iga.progress import choosing

Answer = dict[str, Any]


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
    numbers = [float(part) for part in text.split(",")]  # what argparse makes of a ValueError names the option
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ValueError(text)
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


# --- commands ---------------------------------------------------------------------------------------------------------


def _build(options: argparse.Namespace) -> Answer:
    import geometry
    from iga.store import save
    from studies.describe import Stopwatch, describe, with_quality

    clock = Stopwatch()
    settings = dict(_setting(text) for text in options.set)
    domain = with_quality(geometry.build(options.input, options.source, **settings))
    save(domain, options.output)
    return describe(domain, clock)


def _info(options: argparse.Namespace) -> Answer:
    from iga.store import load
    from studies.describe import Stopwatch, describe

    clock = Stopwatch()
    return describe(load(options.domain), clock)


def _refine(options: argparse.Namespace) -> Answer:
    import geometry
    from iga.store import load, save
    from studies.describe import Stopwatch, describe, with_quality

    clock = Stopwatch()
    levels = options.levels if options.levels is not None else int(options.elevate == 0)
    if levels < 0 or options.elevate < 0:
        raise InputError("--levels and --elevate cannot be negative")
    domain = with_quality(geometry.refine(load(options.domain), levels, options.elevate))
    save(domain, options.output)
    return describe(domain, clock)


def _solve(options: argparse.Namespace) -> Answer:
    import problems
    from iga.exchange.export import write_vtu
    from iga.store import load
    from studies.describe import peak_mb, require_valid

    domain = load(options.domain)
    if not options.allow_invalid:
        require_valid(domain)
    if options.problem is not None:
        if options.physics or options.exact:
            raise InputError("give either a problem file or --heat / --elasticity with --exact, not both")
        solution, answer = problems.solve_case(
            domain, options.problem, solver=options.solver, points=options.quadrature
        )
    else:
        if not options.physics or not options.exact:
            raise InputError("say what to solve: a PROBLEM.toml, or --heat / --elasticity with --exact \"formula\"")
        solution, answer = problems.solve_exact(
            domain, options.physics, options.exact, solver=options.solver or "auto", points=options.quadrature
        )
    if options.output:
        write_vtu(options.output, domain, solution.pictured())
        answer["file"] = str(options.output)
    answer["peak_mb"] = peak_mb()
    return answer


def _study(options: argparse.Namespace) -> Answer:
    from iga.progress import progress
    from studies.study import STUDIES, check_study, list_studies, run_study

    if options.action == "list":
        return {"studies": [{"study": name, "about": about} for name, about in list_studies()]}
    names = options.names or list(STUDIES)
    if options.action == "run" and not options.names:
        raise InputError(f"name the studies to run; there are: {', '.join(STUDIES)}")
    if options.action == "check":
        checks = [check_study(name, progress=progress()) for name in names]
        rows = [
            {"study": c.name, "passed": c.passed, "differences": [str(d) for d in c.differences], "seconds": c.seconds}
            for c in checks
        ]
        return {"checks": rows, "exit": 0 if all(c.passed for c in checks) else 1}
    runs = [run_study(name, options.size, options.out, progress()) for name in names]
    answer = runs[0].to_json() if len(runs) == 1 else {"runs": [run.to_json() for run in runs]}
    if not options.json:
        from studies.report import print_run

        for run in runs:
            print_run(run)
        return {}
    return answer


def _bench(options: argparse.Namespace) -> Answer:
    if options.case == "catmull_clark":
        from studies.bench_catmull_clark import run as run_hexes

        return run_hexes(options.elements or 100_000, options.threads, options.mesh, options.stiffness)
    from studies.bench_cube import run

    mode = "matrix-free" if options.matrix_free else "assembled"
    return dict(run(options.problem, options.degree, options.elements or 16, options.threads, mode))


def _plot(options: argparse.Namespace) -> Answer:
    from studies.drawing import draw

    made = draw(options.file, options.field, options.output, options.cut, options.view, options.up)
    return {"files": [str(made)]}


def _export(options: argparse.Namespace) -> Answer:
    from iga.store import load
    from studies.describe import export

    return {"files": [str(export(load(options.domain), Path(options.output)))]}


def _sources(options: argparse.Namespace) -> Answer:
    import geometry

    known = geometry.sources()
    if options.name is not None:
        if options.name not in known:
            raise InputError(f"no geometry source is called {options.name!r}; there are: {', '.join(known)}")
        build = known[options.name].build
        texts = [sys.modules[build.__module__].__doc__, build.__doc__]
        return {"source": options.name, "about": "\n\n".join(inspect.cleandoc(text) for text in texts if text)}
    rows = []
    for name, source in known.items():
        about = (source.__doc__ or "").strip().splitlines()
        rows.append({"source": name, "about": about[0] if about else ""})
    return {"sources": rows}


def _demo(options: argparse.Namespace) -> Answer:
    from iga.progress import progress
    from studies.demo import demo

    return dict(demo(Path(options.out), progress(), say=not options.json))


def _setting(text: str) -> tuple[str, Any]:
    """``key=value`` with the value as a number or truth value where it reads like one."""
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise InputError(f"--set takes key=value, not {text!r}")
    if value.lower() in ("true", "false"):
        return key, value.lower() == "true"
    for kind in (int, float):
        try:
            return key, kind(value)
        except ValueError:
            continue
    return key, value


# --- what a person sees -----------------------------------------------------------------------------------------------


def _show(answer: Answer, indent: str = "") -> None:
    """Keys and values, nested ones indented."""
    for key, value in answer.items():
        if isinstance(value, dict):
            print(f"{indent}{key}:")
            _show(value, indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            _show_rows(value, indent)
        else:
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            print(f"{indent}{key}: {text}")


def _show_rows(rows: list[Answer], indent: str = "") -> None:
    for row in rows:
        first, *rest = row.values()
        print(f"{indent}{first!s:<28}", *(_short(v) for v in rest))


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "".join(f"\n    {item}" for item in value)
    if isinstance(value, bool):
        return "ok" if value else "DIFFERS"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="iga", formatter_class=argparse.RawDescriptionHelpFormatter, epilog=_EXAMPLES,
        description="Isogeometric analysis on solids that come from anywhere.",
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def command(
        name: str, run: Callable[[argparse.Namespace], Answer], text: str, epilog: str = ""
    ) -> argparse.ArgumentParser:
        made = commands.add_parser(
            name, help=text, description=text[0].upper() + text[1:] + ".", epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        made.add_argument("--json", action="store_true", help="print exactly one JSON object on standard output")
        made.add_argument("--quiet", action="store_true", help="no progress on standard error")
        made.set_defaults(run=run, show=_show)
        return made

    build = command(
        "build", _build, "turn a file into a domain: spline space, control points, named boundaries, validity proof",
        "`iga sources` lists the sources, `iga sources NAME` explains inputs and settings of one. Where no file has\n"
        "the name, INPUT may be a built-in shape, such as thick_ring, cylinder or ball.",
    )
    build.add_argument("input", metavar="INPUT", help="mesh, spline or CAD file")
    build.add_argument("--source", metavar="NAME", help="geometry source; by default the first that reads the file")
    build.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="setting of the source")
    build.add_argument("-o", "--output", required=True, metavar="DOMAIN.npz", help="file to write")

    info = command("info", _info, "describe a saved domain")
    info.add_argument("domain", metavar="DOMAIN.npz")

    refine = command("refine", _refine, "refine a domain without changing its shape")
    refine.add_argument("domain", metavar="DOMAIN.npz")
    refine.add_argument(
        "--levels", type=int, metavar="N", help="halve every element N times (default 1, or 0 with --elevate)"
    )
    refine.add_argument("--elevate", type=int, default=0, metavar="P", help="raise the degree by P first")
    refine.add_argument("-o", "--output", required=True, metavar="OUT.npz", help="file to write; may be the input")

    solve = command(
        "solve", _solve, "solve heat conduction or elasticity on a domain",
        'With --exact, a formula in x, y, z ("u;v;w" for elasticity), all data follow from it by exact\n'
        "differentiation and the errors are reported. A PROBLEM.toml names material, loads and one condition for\n"
        "each boundary name or pattern; problems/examples has commented ones.",
    )
    solve.add_argument("domain", metavar="DOMAIN.npz")
    solve.add_argument("problem", nargs="?", metavar="PROBLEM.toml", help="problem file")
    physics = solve.add_mutually_exclusive_group()
    physics.add_argument("--heat", dest="physics", action="store_const", const="heat", help="heat conduction, k = 1")
    physics.add_argument(
        "--elasticity", dest="physics", action="store_const", const="elasticity",
        help="linear elasticity, E = 1, nu = 0.3",
    )
    solve.add_argument("--exact", metavar="EXPR", help="exact solution that makes the data")
    solve.add_argument(
        "--solver", choices=("auto", "direct", "cg", "matrix-free"), help="linear solver (default auto)"
    )
    solve.add_argument(
        "--quadrature", type=int, metavar="N", help="Gauss points per direction (default: degree + 1)"
    )
    solve.add_argument("--allow-invalid", action="store_true", help="solve even on a domain with folded elements")
    solve.add_argument("-o", "--output", metavar="OUT.vtu", help="Bezier cells with geometry and fields, for ParaView")

    study = command("study", _study, "list, run or check the studies")
    study.add_argument("action", choices=("list", "run", "check"))
    study.add_argument("names", nargs="*", metavar="NAME", help="studies; `check` takes all if none is named")
    study.add_argument("--size", choices=("ci", "full"), default="full", help="seconds or minutes (default full)")
    study.add_argument("--out", default="results", metavar="DIR", help="folder for tables and figures")

    bench = command("bench", _bench, "measure assembly and solution on a standard problem")
    cases = "the unit cube with a curved interior map; hexahedra to interpolating control points"
    bench.add_argument("case", choices=("cube", "catmull_clark"), help=cases)
    bench.add_argument("--problem", choices=("heat", "elasticity"), default="heat")
    bench.add_argument("--degree", type=int, default=3, metavar="P")
    amount = "cube: elements in each direction (16); catmull_clark: hexahedra (100000)"
    bench.add_argument("--elements", type=int, metavar="N", help=amount)
    bench.add_argument("--threads", type=int, default=os.cpu_count() or 1, metavar="T")
    bench.add_argument("--matrix-free", action="store_true", help="cube: apply the operator without assembling it")
    bench.add_argument("--mesh", metavar="FILE", help="catmull_clark: a mesh of hexahedra to take instead")
    bench.add_argument("--stiffness", action="store_true", help="catmull_clark: go on to the stiffness matrix")

    plot = command("plot", _plot, "draw a domain or a solution into an image")
    plot.add_argument("file", metavar="FILE", help="DOMAIN.npz or OUT.vtu")
    plot.add_argument("--field", metavar="F", help="field to colour by")
    plot.add_argument("--cut", metavar="AXIS", help="cut the solid open: x, -x, y, -y, z or -z")
    about = "direction from the solid to the eye (default: oblique); --view=-1,0,0 where it begins with a minus"
    plot.add_argument("--view", metavar="X,Y,Z", type=_direction, help=about)
    plot.add_argument("--up", choices=("x", "y", "z"), default="z", help="axis that points up (default z)")
    plot.add_argument("-o", "--output", required=True, metavar="PNG")

    export = command("export", _export, "write a domain for other programs")
    export.add_argument("domain", metavar="DOMAIN.npz")
    export.add_argument("-o", "--output", required=True, metavar="FILE", help=".vtu, .vtk, .xml (G+Smo) or .bext")

    sources = command("sources", _sources, "list the geometry sources, or say all about one")
    sources.add_argument("name", nargs="?", metavar="NAME", help="source whose inputs and settings to explain")
    sources.set_defaults(show=lambda a: print(a["about"]) if "about" in a else _show_rows(a["sources"]))

    demo = command("demo", _demo, "a tour in three minutes: tables, plots and pictures")
    demo.add_argument("--out", default="results/demo", metavar="DIR")
    demo.set_defaults(show=lambda answer: None)
    return parser


if __name__ == "__main__":
    sys.exit(main())
