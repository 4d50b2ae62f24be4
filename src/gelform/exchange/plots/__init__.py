"""Pictures of results, and of two calibrations side by side (extra `plots`)."""
