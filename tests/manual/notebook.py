"""Runs the code of a notebook in order, as Jupyter would, in the working folder.

python -m tests.manual.notebook FILE [--write]    # with what it shows written back into the file
"""

import sys
from pathlib import Path
from typing import Any

import nbformat
from IPython.core.displayhook import CapturingDisplayHook
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output


def run_cells(notebook: Any) -> str | None:
    """Run the cells of code, keep what each shows, and return the error that ended them, if one did."""
    shell = InteractiveShell.instance()
    shell.display_formatter.active_types = shell.display_formatter.format_types
    results: list[Any] = []
    shell.display_trap.hook = CapturingDisplayHook(shell, results)
    for count, cell in enumerate((cell for cell in notebook.cells if cell.cell_type == "code"), start=1):
        results.clear()
        with capture_output() as captured:
            done = shell.run_cell(cell.source)
        cell.execution_count = count
        cell.outputs = [
            nbformat.v4.new_output("display_data", data=shown.data, metadata=shown.metadata)
            for shown in captured.outputs
        ] + [
            nbformat.v4.new_output("execute_result", execution_count=count, data=dict(shown["data"]))
            for shown in results
        ]
        if captured.stdout:
            cell.outputs.insert(0, nbformat.v4.new_output("stream", name="stdout", text=captured.stdout))
        if not done.success:
            return f"{cell.source}\n{captured.stdout}{captured.stderr}{done.error_before_exec or done.error_in_exec!r}"
    return None


def main(arguments: list[str]) -> int:
    """Run a notebook file, and return 1 if a cell of it failed."""
    file = Path(arguments[0]).resolve()
    notebook = nbformat.read(file, as_version=4)
    nbformat.validate(notebook)
    failure = run_cells(notebook)
    if failure is not None:
        sys.stderr.write(f"{failure}\n")
        return 1
    if "--write" in arguments:
        nbformat.write(notebook, file)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
