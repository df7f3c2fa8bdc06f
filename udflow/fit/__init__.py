"""Fits: from samples to a velocity field. They yield Progress and return the field."""
