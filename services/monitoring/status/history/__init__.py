"""What the status process remembers: plot columns, receivers, tracks, and files that outlive it."""
