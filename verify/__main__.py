"""`python -m verify`: the same as the command."""

from verify.cli.main import main

main()
