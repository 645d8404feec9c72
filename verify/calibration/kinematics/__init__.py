"""Identification of DH parameters and offsets."""
