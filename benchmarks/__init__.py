"""Measurements, kept beside the code they measure."""
