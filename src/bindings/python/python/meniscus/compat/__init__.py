"""Doors for those who call other packages."""
