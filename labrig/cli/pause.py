"""`labrig pause` and `labrig continue`: ask the labrig that makes a run, from another terminal."""

from pathlib import Path
from typing import Literal

from labrig.cli.options import RunArgument
from labrig.cli.output import AsJson, print_json, print_line


def pause(run_path: RunArgument, as_json: AsJson = False) -> int:
    """Exit with 0 when the run is going to pause, or is paused; its own terminal says at which safe point."""
    return _ask(run_path, "pause", as_json=as_json)


def continue_(run_path: RunArgument, as_json: AsJson = False) -> int:
    """Exit with 0 when the run continues; a question at its terminal is not answered by this."""
    return _ask(run_path, "continue", as_json=as_json)


def _ask(run: Path, order: Literal["pause", "continue"], *, as_json: bool) -> int:
    from labrig.runner.run_control import ask_run

    answer = ask_run(run, order)
    if as_json:
        print_json({"run": str(run), "answer": answer})
    else:
        print_line(answer)
    return 0
