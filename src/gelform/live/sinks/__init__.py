"""Other programs that show what `gelform live` shows: Rerun (extra `rerun`), Foxglove (extra `foxglove`)."""
