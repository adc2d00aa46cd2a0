"""Evaluates a solution for `obu solve`: errors, metrics, tables, plots."""
