"""The same answer on every processor: `make test-processors` switches kernels off and compares what comes out."""
