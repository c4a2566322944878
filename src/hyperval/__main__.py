"""python -m hyperval: the command."""

from hyperval.cli import main

main()
