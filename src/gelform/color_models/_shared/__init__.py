"""What color models have in common: regression, small networks, tables, the colours that were seen."""
