"""A run of each example protocol, to be replayed in each environment: `python -m tests.processors.examples FOLDER`."""

import sys
from pathlib import Path

from tests.runner.sessions import EXAMPLES, record_example

if __name__ == "__main__":
    for name in EXAMPLES:
        record_example(Path(sys.argv[1]) / name, name)
