"""Mutation testing: changed statements of Python and C, and the tests that must notice them."""
