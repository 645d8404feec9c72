"""Sessions and results, written in the formats of other programs."""
