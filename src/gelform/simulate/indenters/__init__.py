"""What is pressed into the gel, and how it stands."""
