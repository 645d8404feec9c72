"""Sessions recorded during a run."""
