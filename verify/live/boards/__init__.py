"""Board pictures taken automatically."""
