"""Control charts, change points, comparison."""
