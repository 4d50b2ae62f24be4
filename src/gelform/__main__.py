"""`python -m gelform` is `gelform`."""

from gelform.cli import main

main()
