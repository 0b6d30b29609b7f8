"""`python -m bridge.cli` is `hid2`."""

from bridge.cli import main

main()
