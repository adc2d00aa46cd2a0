"""Checks of the set-up by independent measurements: axes, mounting, signs, delays, scales, lever arm."""
