"""Rauch-Tung-Striebel smoothing over the filter's history."""
