"""Files for others: press folders and simulated data sets."""
