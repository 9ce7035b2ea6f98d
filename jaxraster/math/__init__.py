"""Formulas on plain arrays that know nothing of scenes or pictures."""
