"""LED layouts compared before they are built."""
