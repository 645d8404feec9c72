"""Find sessions, measure them on workers, store and tabulate the results."""
