"""What `labrig run` and `devices home|jog` say of the needle when they end early, in order and in JSON."""

import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, SWEEP, Labrig

pytestmark = pytest.mark.slow

ONE_INSERTION = (
    "--set", "insertions_per_specimen=1", "--set", "specimens=[{name: gel-10, gelatin_percent: 10}]",
    "--set", "rig.world.bubbles_per_specimen=0",
)  # fmt: skip


def _fault(fault: str, axis: str = "insertion") -> tuple[str, str]:
    return ("--set", f"rig.faults=[{{fault: {fault}, axis: {axis}, at_s: 40}}]")


@pytest.mark.parametrize("fault", ["silent", "emergency, code: 0x8611", "unplugged"])
def test_motion_place_remedy_and_record_are_said_in_this_order(
    fault: str, labrig: Labrig, tmp_path: Path
) -> None:
    """A person reads first what the needle is doing; lost drives are told before anything else."""
    axis = "null" if fault == "unplugged" else "insertion"
    done = labrig(
        "run", SWEEP, "--rig", RIG, "--runs-dir", tmp_path, "--json", *ONE_INSERTION, *_fault(fault, axis)
    )
    assert done.exit_code == 3
    is_lost = not fault.startswith("emergency")
    motion = "needle: not every axis is known" if is_lost else "needle: every axis stands still"
    words = (motion, "positions: insertion 3", "error: ", "hint: ", "then: ", "the record is kept: ")
    said = f"\n{done.err}"  # there is no line of progress before where the run was quick
    assert [word for word in words if f"\n{word}" not in said] == [], said
    places = [said.index(f"\n{word}") for word in words]
    assert places == sorted(places)
    told = "press the emergency stop; what the needle is doing is not known"
    assert (said.index(told) < places[0]) if is_lost else (told not in done.err)
    needle = done.json()["needle"]
    assert (needle["motion"], needle["in_tissue"]) == ("unknown" if is_lost else "standing still", True)
    assert [axis["axis"] for axis in needle["axes"]] == ["insertion", "rotation", "linear"]
    assert needle["axes"][0]["position"] == pytest.approx(35, abs=1)
    assert (needle["axes"][0]["age_s"] > 0) is is_lost
    assert done.json()["run"] in done.err
    page = Path(done.json()["report"]).read_text(encoding="utf-8")
    assert ('class="pill failed"' in page, "The run failed: " in page) == (True, True)


@pytest.mark.parametrize(
    ("command", "when"),
    [
        (("jog", "--axis", "linear", "--distance", 5), "moving"),
        (("home", "--axis", "linear", "--method", -4), "homing"),
    ],
    ids=["jog", "home"],
)
@pytest.mark.parametrize("fault", ["silent", "emergency, code: 0x8611"])
def test_home_and_jog_say_where_the_needle_is(
    fault: str, command: tuple[object, ...], when: str, labrig: Labrig, tmp_path: Path
) -> None:
    """They tell at once of lost drives, and then motion, place and error as a run does."""
    rig = tmp_path / "rig.yaml"
    shutil.copytree(RIG.parent, tmp_path, dirs_exist_ok=True)
    script = f"faults: [{{fault: {fault}, axis: linear, at_s: 0, once: {when}}}]\n"
    rig.write_text(f"{RIG.read_text(encoding='utf-8')}\n{script}", encoding="utf-8")
    done = labrig("devices", *command, "--rig", rig)
    assert (done.exit_code, done.out) == (3, "")
    motion = (
        "not every axis is known to stand still: press"
        if fault == "silent"
        else "every axis stands still; no"
    )
    words = (f"needle: {motion}", "positions: linear ", "error: ", "hint: ")
    places = [f"\n{done.err}".find(f"\n{word}") for word in words]
    assert places == sorted(places), done.err
    assert places[0] >= 0, done.err
    told = done.err.find("the drive of axis linear does not answer: press the emergency stop")
    assert (0 <= told < places[0]) is (fault == "silent")
