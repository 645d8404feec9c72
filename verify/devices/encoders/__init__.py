"""LABENC, text lines, growing CSV."""
