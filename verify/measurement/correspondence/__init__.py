"""Which spot is which LED."""
