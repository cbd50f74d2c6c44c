"""`python -m labrig` is `labrig`."""

from labrig.cli.start import main

main()
