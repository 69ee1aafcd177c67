"""`python -m imucalib` is the command `imucal`."""

from imucalib.cli import main

main()
