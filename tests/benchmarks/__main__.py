"""Print every table, or the tables named on the command line.

Several tables run in a process each, so that no table inherits the memory or threads of another, and a table that
fails does not prevent the others. The exit code is then 1, and the last line names the failed tables.
"""

import subprocess
import sys
from collections.abc import Callable
from functools import partial

from tests.benchmarks import (
    campaign_engines,
    can_load,
    catalogue,
    circles,
    closed_loop,
    coverage,
    crash,
    curvature,
    cycle,
    depth,
    engine,
    estimator,
    faults,
    fuzz,
    graph_paper,
    hinge,
    insertion,
    intrinsics,
    live,
    load,
    opening,
    pausing,
    planner,
    real_insertions,
    reanalyze,
    recording,
    reference_world,
    rehearsal,
    ruled_paper,
    shaft_scenes,
    silent_bus,
    start_up,
    sweep,
    tip,
    torsion,
    virtual,
    wandering,
    warp,
    world_agrees,
)

TABLES: dict[str, Callable[[], None]] = {
    "start-up": start_up.print_table,
    "intrinsics": intrinsics.print_table,
    "warp": warp.print_table,
    "real-insertions": real_insertions.print_table,
    "coverage": coverage.print_table,
    "depth": depth.print_table,
    "wandering": wandering.print_table,
    "curvature": curvature.print_table,
    "shaft-scenes": shaft_scenes.print_table,
    "circles": circles.print_table,
    "reanalyze": reanalyze.print_table,
    "ruled-paper": ruled_paper.print_table,
    "graph-paper": graph_paper.print_table,
    "hinge": hinge.print_table,
    "planner": planner.print_table,
    "engine": engine.print_table,
    "campaign-engines": campaign_engines.print_table,
    "estimator": estimator.print_table,
    "reference-world": reference_world.print_table,
    "closed-loop": closed_loop.print_table,
    "closed-loop-reference": partial(closed_loop.print_table, "reference"),
    "closed-loop-hard": partial(closed_loop.print_table, "hard"),
    "torsion": torsion.print_table,
    "virtual": virtual.print_table,
    "world-agrees": world_agrees.print_table,
    "can-load": can_load.print_table,
    "load": load.print_table,
    "tip": tip.print_table,
    "cycle": cycle.print_table,
    "insertion": insertion.print_table,
    "faults": faults.print_table,
    "silent-bus": silent_bus.print_table,
    "fuzz": fuzz.print_table,
    "catalogue": catalogue.print_table,
    "recording": recording.print_table,
    "live": live.print_table,
    "opening": opening.print_table,
    "crash": crash.print_table,
    "sweep": sweep.print_table,
    "pausing": pausing.print_table,
    "rehearsal": rehearsal.print_table,
}


def main(names: list[str]) -> int:
    """Print the tables and return the exit code: 2 for an unknown name, 1 if a table failed."""
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        print(f"unknown benchmark {', '.join(unknown)}; choose from {', '.join(TABLES)}", file=sys.stderr)
        return 2
    if len(names) == 1:
        print(f"\n## {names[0]}", flush=True)
        TABLES[names[0]]()
        return 0
    # closed-loop prints the rows of the tables with its name.
    wanted = names or [name for name in TABLES if not name.startswith("closed-loop-")]
    failed = [name for name in wanted if _run_apart(name) != 0]
    if failed:
        print(f"\nfailed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def _run_apart(name: str) -> int:
    """Print a table in a process of its own and return its exit code."""
    return subprocess.run([sys.executable, "-m", "tests.benchmarks", name], check=False).returncode


sys.exit(main(sys.argv[1:]))
