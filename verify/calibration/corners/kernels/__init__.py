"""Compiled corner model and its fit."""
