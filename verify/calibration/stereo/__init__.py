"""Bundle adjustment of both cameras and their bases."""
