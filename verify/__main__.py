"""`python -m verify`: the same as the command."""

from verify.cli import main

main()
