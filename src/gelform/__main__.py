"""`python -m gelform` runs the command `gelform`."""

from gelform.cli import main

main()
