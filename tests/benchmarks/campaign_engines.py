"""The same campaign on every engine, killed and gone on with, and with a worker killed: the tables are identical.

`python -m tests.benchmarks campaign-engines`. LABRIG_BENCHMARK_TASKS sets how many virtual insertions the campaign has,
2,000 unless set; at 10 a second that is a quarter of an hour in all.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from dask.distributed import LocalCluster

from labrig.analysis.campaign_table import ROWS_FILE
from tests.benchmarks.engine import open_local_cluster
from tests.benchmarks.table import print_rows

TASKS = int(os.environ.get("LABRIG_BENCHMARK_TASKS", "2000"))
ROOT = Path(__file__).parents[2]
WORKERS = 2
_LOOK_S = 0.1


def print_table() -> None:
    """Print the time and the digest of the table for each way of computing the campaign."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "campaign.yaml"
        file.write_text(json.dumps(_describe(TASKS)), encoding="utf-8")
        ways: dict[str, Callable[[list[str], Path], str]] = {
            "process pool": _run_alone,
            "kill -9 of labrig, then gone on with": _run_killed,
            "dask, two local workers": _run_on_dask,
            "dask, a worker killed in the middle": _run_on_dask_with_a_loss,
        }
        rows = []
        for number, (way, run) in enumerate(ways.items()):
            out = folder / str(number)
            began_s = time.perf_counter()
            note = run([sys.executable, "-m", "labrig", "campaign", str(file), "--out", str(out)], out)
            rows.append([way, f"{time.perf_counter() - began_s:.0f}", _digest(out), note])
    same = len({row[2] for row in rows}) == 1
    print_rows((f"{TASKS} tasks", "s", "SHA-256 of the table", "killed after"), rows)
    print("the tables are identical" if same else "THE TABLES DIFFER")
    if not same:
        raise SystemExit(1)


def _describe(tasks: int) -> dict[str, object]:
    return {
        "campaign": "engines",
        "base": str(ROOT / "protocols" / "insertion.yaml"),
        "rig": str(ROOT / "calibration" / "rig-reference.yaml"),
        "depth": "world",
        "vary": {"policy.replan_every_mm": [20, 40]},
        "repetitions": tasks // 2,
        "seed": 5,
    }


def _run_alone(command: list[str], _: Path) -> str:
    subprocess.run([*command, "--workers", str(WORKERS)], check=True, capture_output=True)
    return "-"


def _run_killed(command: list[str], out: Path) -> str:
    """Kill the process in the middle, with no chance to clean up, and start the same command again."""
    process = _start([*command, "--workers", str(WORKERS)])
    runs = _wait_until_half_done(process, out)
    process.kill()
    process.wait()
    kept = _count_done(out)
    _run_alone(command, out)
    return f"{kept} tasks" if runs else "it had ended"


def _run_on_dask(command: list[str], _: Path) -> str:
    with open_local_cluster(WORKERS) as cluster:
        subprocess.run([*command, "--cluster", cluster.scheduler_address], check=True, capture_output=True)
    return "-"


def _run_on_dask_with_a_loss(command: list[str], out: Path) -> str:
    with open_local_cluster(WORKERS) as cluster:
        process = _start([*command, "--cluster", cluster.scheduler_address])
        runs = _wait_until_half_done(process, out)
        kept = _count_done(out)
        _kill_worker(cluster)
        if process.wait() != 0:
            raise RuntimeError(f"labrig campaign ended with {process.returncode}")
    return f"{kept} tasks" if runs else "it had ended"


def _kill_worker(cluster: LocalCluster) -> None:
    os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)


def _start(command: list[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _wait_until_half_done(process: subprocess.Popen[bytes], out: Path) -> bool:
    """Return whether the process still runs when parts with half of the rows are kept."""
    while process.poll() is None:
        if _count_done(out) >= TASKS // 2:
            return True
        try:
            process.wait(_LOOK_S)
        except subprocess.TimeoutExpired:
            continue
    return False


def _count_done(out: Path) -> int:
    """Return how many rows a folder holds."""
    file = out / ROWS_FILE
    return file.read_bytes().count(b"\n") if file.exists() else 0


def _digest(out: Path) -> str:
    """Return the digest of the rows."""
    return f"{hashlib.sha256((out / ROWS_FILE).read_bytes()).hexdigest()[:16]} ({_count_done(out)} rows)"
