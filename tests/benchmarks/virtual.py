"""Virtual insertions of protocols/insertion.yaml on the simulated rig: how fast, how true, and how honest they are.

`virtual` prints insertions a second by one process and by two, for three policies: `every 20 mm` replans as the paper
does, with labrig's planner and filter; `paper` has the paper's planner and filter too. A second process gives at most
what the computer has. Where the time goes: `python -m cProfile -s tottime -m labrig campaign`.

`wandering` lets the needle wander out of the plane more than the protocol says, and counts false successes. A run
judges itself by its last picture, which tells the needle's depth by its width and length; the world knows where its
tip is. Where the needle wanders as the protocol says, the same runs show what that caution costs.
"""

import os
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from labrig.analysis.experiment import TaskOutcome
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.protocol.load import load_protocol
from labrig.runner.dry_run import simulate
from labrig.runner.sight import load_plane_map
from labrig.vision.plane import PlaneMap
from tests.benchmarks.table import multiply, print_rows

ROOT = Path(__file__).parents[2]
PROTOCOL, RIG = ROOT / "protocols" / "insertion.yaml", ROOT / "calibration" / "rig-simulated.yaml"
INSERTIONS = multiply(20)
WANTED = {"default": "10", "every 20 mm": "40"}
"""Insertions a second that are wanted of two processes."""
_EVERY_20_MM = (
    "policy.deviation_mm=null", "policy.near_mm=0", "policy.final_mm=0", "policy.backlash_mm=0", "policy.closing_mm=0",
)  # fmt: skip
_PAPER = (
    "planner.method=paper", "estimator.method=paper", "estimator.radius_sd_mm=0", "estimator.cavity_every_mm=null",
)  # fmt: skip
POLICIES: Mapping[str, tuple[str, ...]] = {
    "default": (), "every 20 mm": _EVERY_20_MM, "paper": (*_EVERY_20_MM, *_PAPER),
}  # fmt: skip
"""Settings of protocols/insertion.yaml by the name of the policy."""
WANDERS_DEG = (0.05, 0.2, 0.3, 0.5)


@cache
def read_policy(policy: str = "default") -> InsertionProtocol:
    """Return protocols/insertion.yaml with a policy."""
    protocol: Any = load_protocol(PROTOCOL, PROTOCOL_MODELS, list(POLICIES[policy]))
    assert isinstance(protocol, InsertionProtocol)
    return protocol


@cache
def read_simulated_rig() -> RigDescription:
    """Return calibration/rig-simulated.yaml."""
    return load_rig(RIG)


@cache
def load_plane() -> PlaneMap:
    """Return the plane map of that rig."""
    return load_plane_map(read_simulated_rig())


def insert(seed: int, policy: str = "default", wanders_deg: float | None = None) -> TaskOutcome:
    """Make a virtual insertion, in a world that wanders so much out of the plane [deg / mm^0.5]."""
    rig = read_simulated_rig()
    if wanders_deg is not None:
        assert rig.world is not None
        more = {"out_of_plane_deg_per_root_mm": wanders_deg}
        disturbances = rig.world.disturbances.model_copy(update=more)
        world = rig.world.model_copy(update={"disturbances": disturbances})
        rig = rig.model_copy(update={"world": world})
    return simulate(find_experiment("insertion"), read_policy(policy), rig, seed)


def print_rates() -> None:
    """Print the rates of each policy."""
    rows = []
    for policy in POLICIES:
        (one_s, cpu_s), (two_s, _) = (_time(policy, workers) for workers in (1, 2))
        rates = (f"{INSERTIONS / one_s:.1f}", f"{INSERTIONS / two_s:.1f}", f"{one_s / two_s:.2f}")
        rows.append([policy, *rates, WANTED.get(policy, "-"), f"{cpu_s / INSERTIONS:.3f}"])
    heads = ("policy", "1 process, 1/s", "2 processes, 1/s", "ratio", "wanted of 2", "processor s each")
    print_rows(heads, rows)


def _time(policy: str, workers: int) -> tuple[float, float]:
    """Return the wall time of the insertions by so many processes, and their processor time [s]."""
    work = partial(_time_insertion, policy)
    with ProcessPoolExecutor(workers, get_context("fork")) as pool:
        list(pool.map(work, range(2 * workers)))  # imports, and the first plan
        began_s = time.perf_counter()
        cpu_s = sum(pool.map(work, range(300_000, 300_000 + INSERTIONS)))
        return time.perf_counter() - began_s, cpu_s


def _time_insertion(policy: str, seed: int) -> float:
    began_s = time.process_time()
    insert(seed, policy)
    return time.process_time() - began_s


def end_wandering(wanders_deg: float, seed: int) -> tuple[bool, bool]:
    """Return whether an insertion says success, and whether it truly ends beyond the tolerance."""
    outcome, allowed_mm = insert(seed, wanders_deg=wanders_deg), read_policy().target.tolerance_mm
    error_mm: Any = outcome.values["true_target_error_mm"]
    return outcome.exit_status == "success", error_mm is not None and float(error_mm) > allowed_mm


def print_wandering() -> None:
    """Print a row for each wandering: how many insertions say success, and how many of these are false."""
    rows = []
    with ProcessPoolExecutor(os.cpu_count(), get_context("fork")) as pool:
        for wanders_deg in WANDERS_DEG:
            seeds = range(740_000, 740_000 + INSERTIONS)
            ends = list(pool.map(partial(end_wandering, wanders_deg), seeds))
            counts = (
                sum(beyond for _, beyond in ends), sum(said for said, _ in ends), ends.count((True, True)),
            )  # fmt: skip
            rows.append([f"{wanders_deg:g}", len(ends), *counts])
    heads = ("wanders, deg / mm^0.5", "insertions", "truly beyond", "say success", "false successes")
    print_rows(heads, rows)
    print("wanted: no false success")
