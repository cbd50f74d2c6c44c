"""`python -m labrig` is `labrig`."""

from labrig.cli.main import main

main()
