"""Budget and Monte-Carlo check."""
