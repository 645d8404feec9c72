"""Summary.json, tables, warnings."""
