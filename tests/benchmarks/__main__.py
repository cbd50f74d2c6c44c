"""Print every table, or those named on the command line."""

import sys

from tests.benchmarks import (
    can_load,
    catalogue,
    circles,
    closed_loop,
    crash,
    curvature,
    cycle,
    estimator,
    faults,
    hinge,
    insertion,
    intrinsics,
    planner,
    real_insertions,
    reanalyze,
    recording,
    rot,
    ruled_paper,
    start_up,
    sweep,
    tip,
)

TABLES = {
    "start-up": start_up.print_table,
    "intrinsics": intrinsics.print_table,
    "real-insertions": real_insertions.print_table,
    "curvature": curvature.print_table,
    "circles": circles.print_table,
    "reanalyze": reanalyze.print_table,
    "ruled-paper": ruled_paper.print_table,
    "hinge": hinge.print_table,
    "planner": planner.print_table,
    "estimator": estimator.print_table,
    "closed-loop": closed_loop.print_table,
    "can-load": can_load.print_table,
    "tip": tip.print_table,
    "cycle": cycle.print_table,
    "insertion": insertion.print_table,
    "faults": faults.print_table,
    "catalogue": catalogue.print_table,
    "recording": recording.print_table,
    "crash": crash.print_table,
    "rot": rot.print_table,
    "sweep": sweep.print_table,
}


def main(names: list[str]) -> int:
    """Print the tables and return the exit code: 2 for an unknown name."""
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        print(f"no table {', '.join(unknown)}; there are {', '.join(TABLES)}", file=sys.stderr)
        return 2
    for name in names or list(TABLES):
        print(f"\n## {name}")
        TABLES[name]()
    return 0


sys.exit(main(sys.argv[1:]))
