"""Compiled small linear algebra and reading interpolation."""
