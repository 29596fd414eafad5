"""Checks that ship: models with exact answers, references, coverage."""
