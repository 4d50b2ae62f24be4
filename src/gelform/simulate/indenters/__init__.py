"""What is pressed into the gel."""
