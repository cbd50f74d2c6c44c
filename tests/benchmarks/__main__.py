"""Print every table, or the tables and groups named on the command line: accuracy, steering, speed, insertions.

A figure is from as much as a quarter of an hour allows; LABRIG_BENCHMARK_TIMES=5 takes five times as much.
Several tables run in a process each, so that no table inherits the memory or threads of another, and a table that
fails does not prevent the others. The exit code is then 1, and the last line names the failed tables.
"""

import subprocess
import sys
from importlib import import_module

GROUPS = {
    "accuracy": {
        "intrinsics": "intrinsics.print_table",
        "graph-paper": "graph_paper.print_table",
        "ruled-paper": "graph_paper.print_photographs",
        "curvature": "curvature.print_table",
        "coverage": "coverage.print_table",
        "tip": "tip.print_table",
        "real-insertions": "real_insertions.print_table",
    },
    "steering": {
        "planner": "planner.print_table",
        "estimator": "estimator.print_table",
        "closed-loop": "closed_loop.print_table",
    },
    "speed": {
        "start-up": "start_up.print_start_up", "catalogue": "start_up.print_catalogue",
        "can-load": "can_load.print_table", "recording": "recording.print_table",
        "sweep": "sweep.print_table",
    },
    "insertions": {
        "insertion": "insertion.print_table",
        "virtual": "virtual.print_rates",
        "wandering": "virtual.print_wandering",
    },
}  # fmt: skip
"""The tables of each group, and the functions that print them; a table loads its own module alone."""
TABLES = {name: show for group in GROUPS.values() for name, show in group.items()}


def main(names: list[str]) -> int:
    """Print the tables and return the exit code: 2 for an unknown name, 1 if a table failed."""
    known = (*GROUPS, *TABLES)
    unknown = [name for name in names if name not in known]
    if unknown:
        print(f"unknown benchmark {', '.join(unknown)}; choose from {', '.join(known)}", file=sys.stderr)
        return 2
    wanted = [table for name in names or GROUPS for table in GROUPS.get(name, (name,))]
    if wanted == names[:1]:
        print(f"\n## {names[0]}", flush=True)
        module, show = TABLES[names[0]].split(".")
        getattr(import_module(f"tests.benchmarks.{module}"), show)()
        return 0
    failed = [name for name in wanted if _run_apart(name) != 0]
    if failed:
        print(f"\nfailed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def _run_apart(name: str) -> int:
    """Print a table in a process of its own and return its exit code."""
    return subprocess.run([sys.executable, "-m", "tests.benchmarks", name], check=False).returncode


sys.exit(main(sys.argv[1:]))
