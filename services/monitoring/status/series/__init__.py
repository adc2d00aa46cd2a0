"""The last hour of any numeric field of any message, on a time grid of one second, within a bound."""
