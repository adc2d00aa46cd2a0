"""Publishes the messages of a recording in place of every process."""
