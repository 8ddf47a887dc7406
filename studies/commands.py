"""What each command of the command line does: from its options to its answer, the keys of the JSON object.

Libraries are imported where they are used: ``iga --help`` and ``iga study list`` should not wait for them. The place of
a file to write is looked at before the work that ends in it.
"""

from __future__ import annotations

import argparse
import inspect
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from iga.errors import InputError
from iga.exchange.files import require_place

Answer = dict[str, Any]


def build(options: argparse.Namespace) -> Answer:
    """Turn an input into a saved domain."""
    import geometry
    from iga.clock import Clock
    from iga.store import save
    from studies.describe import describe, with_quality

    clock = Clock()
    output = require_place(options.output)
    domain = with_quality(geometry.build(options.input, options.source, **settings_of(options.set)))
    save(domain, output)
    return describe(domain, clock)


def info(options: argparse.Namespace) -> Answer:
    """Describe a saved domain."""
    from iga.clock import Clock
    from iga.store import load
    from studies.describe import describe

    clock = Clock()
    return describe(load(options.domain), clock)


def refine(options: argparse.Namespace) -> Answer:
    """Refine a saved domain."""
    import geometry
    from iga.clock import Clock
    from iga.store import load, save
    from studies.describe import describe, with_quality

    clock = Clock()
    output = require_place(options.output)
    levels = options.levels if options.levels is not None else int(options.elevate == 0)
    if levels < 0 or options.elevate < 0:
        raise InputError("--levels and --elevate cannot be negative")
    domain = with_quality(geometry.refine(load(options.domain), levels, options.elevate))
    save(domain, output)
    return describe(domain, clock)


def solve(options: argparse.Namespace) -> Answer:
    """Solve a problem on a saved domain."""
    import problems
    from iga.exchange.export import write_vtu
    from iga.store import load
    from studies.describe import peak_mb, require_valid

    if options.output:
        require_place(options.output, ".vtu")
    if options.problem is not None and (options.physics or options.exact):
        raise InputError("give either a problem file or --heat / --elasticity with --exact, not both")
    if options.problem is None and not (options.physics and options.exact):
        raise InputError('say what to solve: a PROBLEM.toml, or --heat / --elasticity with --exact "formula"')
    domain = load(options.domain)
    if not options.allow_invalid:
        require_valid(domain)
    if options.problem is not None:
        solution, answer = problems.solve_case(
            domain, options.problem, solver=options.solver, points=options.quadrature
        )
    else:
        solution, answer = problems.solve_exact(
            domain, options.physics, options.exact, solver=options.solver or "auto", points=options.quadrature
        )
    if options.output:
        write_vtu(options.output, domain, solution.pictured())
        answer["file"] = str(options.output)
    answer["peak_mb"] = peak_mb()
    return answer


def study_list(options: argparse.Namespace) -> Answer:
    """Names of the studies and their questions."""
    from studies.study import list_studies

    return {"studies": [{"study": name, "about": about} for name, about in list_studies()]}


def study_run(options: argparse.Namespace) -> Answer:
    """Run studies and write what they find."""
    from iga.progress import progress
    from studies.report import print_run
    from studies.study import find, run_study

    modules = [find(name) for name in options.names]
    runs = []
    for module in modules:
        runs.append(run_study(module, options.size, options.out, progress()))
        if not options.json:
            print_run(runs[-1])
    told = runs[0].to_json() if len(runs) == 1 else {"runs": [run.to_json() for run in runs]}
    return {**told, "exit": 1 if any(run.undrawn for run in runs) else 0}


def study_check(options: argparse.Namespace) -> Answer:
    """Compare studies with their baselines."""
    from iga.progress import progress
    from studies.study import STUDIES, check_study, find

    modules = [find(name) for name in options.names or STUDIES]
    rows = []
    for module in modules:
        check = check_study(module, progress=progress())
        if not options.json:
            print(check)
        rows.append({
            "study": check.name, "passed": check.passed, "differences": [str(d) for d in check.differences],
            "seconds": check.seconds,
        })
    return {"checks": rows, "exit": 0 if all(row["passed"] for row in rows) else 1}


def bench_cube(options: argparse.Namespace) -> Answer:
    """Assembly and solution on a cube with a curved interior map."""
    from studies.bench_cube import run

    mode = "matrix-free" if options.matrix_free else "assembled"
    return dict(run(options.problem, options.degree, options.elements, options.threads, mode))


def bench_catmull_clark(options: argparse.Namespace) -> Answer:
    """Stages of subdivision, from hexahedra to interpolating control points."""
    from studies.bench_catmull_clark import run

    return dict(run(options.elements, options.threads, options.mesh, options.stiffness))


def plot(options: argparse.Namespace) -> Answer:
    """Draw a domain or a solution."""
    from studies.drawing import draw

    made = draw(options.file, options.field, options.output, options.cut, options.view, options.up)
    return {"files": [str(made)]}


def export(options: argparse.Namespace) -> Answer:
    """Write a domain for other programs."""
    from iga.store import load
    from studies.describe import export

    output = require_place(options.output)
    return {"files": [str(export(load(options.domain), output))]}


def sources(options: argparse.Namespace) -> Answer:
    """List the geometry sources, or explain one: what the module of its `build` says, or `build` itself."""
    import geometry

    known = geometry.sources()
    if options.name is not None:
        if options.name not in known:
            raise InputError(f"no geometry source is called {options.name!r}; there are: {', '.join(known)}")
        make = known[options.name].build
        about = sys.modules[make.__module__].__doc__ or make.__doc__ or ""
        return {"source": options.name, "about": inspect.cleandoc(about)}
    rows = []
    for name, source in known.items():
        lines = (source.__doc__ or "").strip().splitlines()
        rows.append({"source": name, "about": lines[0] if lines else ""})
    return {"sources": rows}


def demo(options: argparse.Namespace) -> Answer:
    """The tour."""
    from iga.progress import progress
    from studies.demo import demo

    return dict(demo(Path(options.out), progress(), say=not options.json))


def settings_of(texts: Sequence[str]) -> dict[str, str]:
    """Values by key of texts ``key=value``; the source knows what its values are (`geometry.parameters`).

    Raises
    ------
    InputError : there is no key or no sign between them, or a key is given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        key, sign, value = text.partition("=")
        if not sign or not key:
            raise InputError(f"--set takes key=value, not {text!r}")
        if key in found:
            raise InputError(f"--set {key} is given twice, {found[key]!r} and {value!r}")
        found[key] = value
    return found
