"""Many drawn cases, more than every change can wait for: `python -m tests.processors --many`.

`python -m tests.processors.many FILE [NAME ...]` writes what comes of them, or of the named ones, as JSON.
"""

import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from labrig.campaign.tasks import compute_task
from labrig.steering.parameters import PlanMethod
from labrig.steering.planner import plan_path
from labrig.steering.problem import PlanProblem, Surroundings
from labrig.steering.score import pick_best_feasible
from labrig.vision import calibrate_intrinsics
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings, measure_curvature
from labrig.vision.tip import TIP_SIGMA_PX, locate_tip
from tests.benchmarks.planning_problems import draw_planar_problem, draw_spatial_problems, draw_tunnel
from tests.campaign.campaigns import RIGS, load, write_campaign
from tests.processors.probes import Case, write_cases
from tests.vision.rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle
from tests.vision.tips import tip
from tests.vision.warped_boards import SimulatedBoard, SimulatedCamera, draw_views, parabolas

_PROBLEMS, _SPATIAL, _TUNNELS = 200, 40, 30
_TIPS, _SHAFTS, _LENSES = 200, 40, 10
_VIRTUAL, _WHOLE = 200, 20
_ENDS = ("target_error_low_mm", "target_error_high_mm")


def plan_paths() -> Iterator[Case]:
    """Plan in the plane, in tunnels and in space; also symmetrical problems, where two paths cost the same."""
    planar = [draw_planar_problem(np.random.default_rng([5, k]), 2 + k % 8) for k in range(_PROBLEMS)]
    tunnels = [draw_tunnel(np.random.default_rng([7, 1, k]), 0.15) for k in range(_TUNNELS)]
    ahead = [PlanProblem((0.0, 0.0, float(z)), planar=True) for z in range(20, 110, 5)]
    for name, problems in (("plane", planar), ("tunnel", tunnels), ("straight ahead", ahead)):
        for number, problem in enumerate(problems):
            yield _plan(f"{name} {number}", problem, "best")
    for number, problem in enumerate(draw_spatial_problems(_SPATIAL, seed=3)):
        yield _plan(f"space {number}", problem, "best")
    for number, problem in enumerate(planar[: _PROBLEMS // 4]):
        yield _plan(f"resolved rate {number}", problem, "paper")


def _plan(name: str, problem: PlanProblem, method: PlanMethod) -> Case:
    plan = plan_path(problem, method)
    if not plan.found:
        return Case(name, f"none: {plan.reason}", {})
    scored = pick_best_feasible(plan.psi[None], Surroundings(problem)) if plan.arcs else None
    cost = 0.0 if scored is None else scored.cost
    arcs = [round(arc.length_mm, 3) for arc in plan.arcs]
    rolls = [round(arc.roll_rad, 3) for arc in plan.arcs]
    return Case(
        name,
        str((len(arcs), round(cost, 6))),
        {
            "arc of a plan [mm]": [(length, 0.05) for length in arcs],
            "roll of a plan": [(abs(roll), 0.01) for roll in rolls],
        },
    )


def insert_in_worlds() -> Iterator[Case]:
    """Compute virtual insertions with the default policy and with the paper's."""
    yield from _insert("world", _VIRTUAL, "rig-reference")


def insert_on_rigs() -> Iterator[Case]:
    """Make whole insertions on the simulated rig."""
    yield from _insert("rig", _WHOLE, "rig-simulated")


def _insert(depth: str, repetitions: int, rig: str) -> Iterator[Case]:
    with tempfile.TemporaryDirectory() as folder:
        arms = {"default": {}, "paper": {"policy": "paper"}} if depth == "world" else {"default": {}}
        file = write_campaign(Path(folder), repetitions=repetitions, depth=depth, arms=arms)
        for task in load(file, RIGS / f"{rig}.yaml").list_tasks():
            outcome = compute_task(task)
            sd_mm = task.arm.protocol.model_dump()["estimator"]["observation_sd_mm"]
            values = outcome.values
            counts = {key: value for key, value in values.items() if isinstance(value, int)}
            lengths_mm = {key: value for key, value in values.items() if isinstance(value, float)}
            # The interval in space is of another spread than a sighting.
            ends_mm = [lengths_mm[key] for key in _ENDS if key in lengths_mm]
            spread_mm = max([sd_mm, *np.ptp(np.reshape(ends_mm, (-1, 2)), axis=1) / 4])
            numbers = {
                f"{depth}: {key}": [(value, spread_mm if key in _ENDS else sd_mm)]
                for key, value in lengths_mm.items()
            }
            yield Case(f"{depth} {task.number}", str((outcome.exit_status, outcome.reason, counts)), numbers)


def find_tips() -> Iterator[Case]:
    """Find the tip in rendered pictures."""
    template = tip(0.0, 100).template()
    random = np.random.default_rng(0)
    for seed in range(_TIPS):
        shown = tip(float(random.uniform(-0.9, 0.9)), seed)
        near = (shown.px[0] + random.uniform(-15, 15), shown.px[1] + random.uniform(-15, 15))
        hint = shown.heading_rad + random.uniform(-0.08, 0.08)
        fix = locate_tip(shown.picture, template, near_px=near, heading_rad=hint, roll_rad=0.0)
        numbers = (
            {}
            if fix.tip_px is None
            else {
                "tip [px]": [(at, TIP_SIGMA_PX) for at in fix.tip_px],
                "tip heading": [(fix.heading_rad, 0.02)],
                "tip score": [(fix.score, 0.1), (fix.distinctness, 0.1)],
            }
        )
        yield Case(f"tip {seed}", str((fix.accepted, fix.reason)), numbers)


def measure_shafts() -> Iterator[Case]:
    """Measure radius and tip in rendered pictures."""
    bench = RenderedBench(RenderedLens())
    plane = RenderedLens().plane_map()
    random = np.random.default_rng(1)
    for seed in range(_SHAFTS):
        needle = RenderedNeedle(
            28.0,
            float(random.uniform(8, 45)),
            sheath_tip_mm=(random.uniform(-2.0, 6.0), random.uniform(-1.0, 3.0)),
        )
        found = measure_curvature(bench.picture(needle, RenderedGel(), seed), plane, CurvatureSettings())
        yield _read_shaft(f"shaft {seed}", found)


def _read_shaft(name: str, found: CurvatureMeasurement) -> Case:
    numbers: dict[str, list[tuple[float, float]]] = {}
    if found.radius_mm is not None and found.sigma_radius_mm:
        numbers["radius"] = [
            (found.radius_mm, found.sigma_radius_mm),
            (found.sigma_radius_mm, found.sigma_radius_mm),
        ]
    if found.tip_mm is not None:
        numbers["end"] = [(at, 0.05) for at in found.tip_mm]
    return Case(name, str((found.found, found.accepted, found.reason)), numbers)


def calibrate_lenses() -> Iterator[Case]:
    """Calibrate a lens from drawn corners."""
    camera, board = SimulatedCamera(), SimulatedBoard(height_mm=parabolas(0.1, 0.05))
    for draw in range(_LENSES):
        for count in (6, 12):
            views = draw_views(camera, board, count, np.random.default_rng((count, draw)))
            lens = calibrate_intrinsics([board.points_mm] * count, views, camera.size)
            numbers = {
                f"lens {name}": [(getattr(lens, name), lens.sigma[name] or math.inf)]
                for name in ("fx", "fy", "cx", "cy")
            }
            yield Case(
                f"lens {count} {draw}",
                str((lens.accepted, lens.reasons, [view.used for view in lens.views])),
                numbers,
            )


MANY: Mapping[str, Callable[[], Iterator[Case]]] = {
    "plans": plan_paths,
    "tips": find_tips,
    "shafts": measure_shafts,
    "lenses": calibrate_lenses,
    "worlds": insert_in_worlds,
    "rigs": insert_on_rigs,
}

if __name__ == "__main__":
    write_cases(Path(sys.argv[1]), [MANY[name] for name in sys.argv[2:] or MANY])
