"""`labrig pause` and `labrig continue`: ask the labrig that makes a run, from another terminal."""

from pathlib import Path
from typing import Literal

from labrig.cli.options import RunArgument
from labrig.cli.output import print_json, print_line, say


def pause(run_path: RunArgument) -> None:
    """Exit with 0 when the run is going to pause, or is paused; its own terminal says at which safe point."""
    _ask(run_path, "pause")


def continue_(run_path: RunArgument) -> None:
    """Exit with 0 when the run continues; a question at its terminal is not answered by this."""
    _ask(run_path, "continue")


def _ask(run: Path, order: Literal["pause", "continue"]) -> None:
    from labrig.runner.run_control import ask_run

    answer = ask_run(run, order)
    print_json({"run": str(run), "answer": answer})
    say(f"{run}:")
    print_line(answer)
