"""Fault models, search, candidates, detectability."""
