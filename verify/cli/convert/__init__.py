"""`verify convert`: other programs' recordings in, other programs' files out."""
