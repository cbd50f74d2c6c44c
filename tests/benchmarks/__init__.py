"""Speed, memory and accuracy, as tables: `make benchmarks`, or `python -m tests.benchmarks NAME` for one of them."""
