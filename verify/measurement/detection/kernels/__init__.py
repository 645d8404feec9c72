"""Compiled loops over pixels: candidates, fit, noise, quality, occlusion."""
