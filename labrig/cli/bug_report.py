"""What is left of a bug: a file with its traceback, and the words that name it.

It imports only the standard library, so that it can also report an import of labrig that fails.
"""

import sys
import tempfile
import traceback

from labrig import __version__


def keep_traceback(error: Exception) -> tuple[str, str]:
    """Write the traceback of a bug into a new file; return the message of the bug, and a hint that names the file."""
    message = f"labrig itself failed: {type(error).__name__}: {error}"
    lines = [f"labrig {__version__}: {' '.join(sys.argv)}\n\n", *traceback.format_exception(error)]
    try:
        descriptor, path = tempfile.mkstemp(".txt", "labrig-bug-")
        with open(descriptor, "w", encoding="utf-8", errors="backslashreplace") as file:  # noqa: PTH123
            file.writelines(lines)
    except OSError as unwritten:
        return message, f"its traceback could not be written: {unwritten.strerror}; please report it"
    return message, f"please report it, with the traceback in {path}"
