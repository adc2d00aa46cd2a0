"""Benchmark of the V2X reception path."""
