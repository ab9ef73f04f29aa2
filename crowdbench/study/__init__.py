"""Turning stored numbers into tables, figures and pages."""
