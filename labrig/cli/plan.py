"""`labrig plan`: plans a path for a scenario, without a rig."""

from math import degrees
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from labrig.cli.calibration_files import require_writable
from labrig.cli.output import print_json, print_line, print_table
from labrig.errors import InputError
from labrig.text import format_count, number


def plan(
    scenario: Annotated[
        Path, Argument(metavar="SCENARIO", help="Needle, target and obstacles (YAML or JSON).")
    ],
    figure: Annotated[Path | None, Option(metavar="FILE", help="Draw the plan, .svg or .png.")] = None,
) -> int:
    """Exit with 0 when a path was found, 1 when there is none, 2 when the scenario is wrong."""
    from labrig.devices.clocks import SystemClock
    from labrig.library.scenario import load_scenario, make_problem
    from labrig.steering.planner import plan_path

    if figure is not None:  # refused before anything is planned
        if figure.suffix.lower() not in {".svg", ".png"}:
            raise InputError(
                f"{figure.name} is neither .svg nor .png", "name the figure plan.svg, for example"
            )
        require_writable(figure, force=False, hint="name another file")
    asked = load_scenario(scenario)
    problem = make_problem(asked)
    clock = SystemClock()
    found = plan_path(problem, asked.method)
    document = {**found.to_json(), "elapsed_s": clock.now_s()}
    if figure is not None:
        from labrig.report.plan_figure import write_plan_figure

        write_plan_figure(figure, problem, found)
    print_json(document)
    _print(document)
    return 0 if found.found else 1


def _print(document: dict[str, Any]) -> None:
    if not document["found"]:
        print_line(f"no path: {document['reason']}")
        return
    rows = [
        [no, f"{degrees(arc['roll_rad']):.1f}", f"{degrees(arc['angle_rad']):.1f}", f"{arc['length_mm']:.2f}"]
        for no, arc in enumerate(document["arcs"], 1)
    ]
    print_table(("arc", "turn degrees", "angle degrees", "length mm"), rows)
    x, y, z = document["tip_mm"]
    print_line(
        f"\n{format_count(len(rows), 'arc')}, {document['length_mm']:.1f} mm, tip at {x:.2f}, {y:.2f}, {z:.2f} mm, "
        f"{document['target_error_mm']:.2f} mm from the target, clearance {number(document['clearance_mm'], 2)} mm, "
        f"planned in {1000 * document['elapsed_s']:.1f} ms"
    )
    if document["worst_target_error_mm"] is not None:
        print_line(
            "Followed without looking, a needle of the worst radius within its tolerance would end "
            f"{document['worst_target_error_mm']:.1f} mm from the target, with a clearance of "
            f"{number(document['worst_clearance_mm'], 2)} mm."
        )
