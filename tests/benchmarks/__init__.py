"""Speed, memory and accuracy, as tables: `make benchmarks`, or `python -m tests.benchmarks NAME` for one of them."""

import labrig  # noqa: F401 - chooses the kernels of OpenBLAS, which it can only do before numpy is loaded
