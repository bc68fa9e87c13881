"""Measurements behind the numbers in the README; each script takes --quick and --json FILE."""
