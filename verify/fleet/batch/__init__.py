"""Find, share out, keep, tabulate."""
